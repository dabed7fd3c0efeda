"""What has wings is calibrated while its rotors hold it, and told to hover where it flies on its wings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from bent_vehicles import bent_vehicle, calibrated

from mavcompass.enums import MavVtolState, PlaneMode
from mavcompass.errors import Refused
from mavcompass.procedure.script import Machine
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.turning import TurnBy
from mavcompass.procedure.vehicle_state import find_vehicle
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.profiles import VehicleProfile
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import GROUND_STATION
from mavcompass.vehicle.links.simulated import SimulatedLink

BY_STICKS: dict[str, TurnBy] = {"quadplane": "manual-control", "px4-vtol": "auto"}


@pytest.mark.parametrize("kind", BY_STICKS)
def test_one_command_brings_the_heading_of_one_that_hovers_within_half_a_degree(
    kind: str, tmp_path: Path
) -> None:
    vehicle = bent_vehicle(kind, seed=11)
    mode = vehicle.firmware.reports.heartbeat().custom_mode
    height_m = vehicle.body.height_m
    report = calibrated(vehicle, tmp_path, by_sticks(kind), identity=GROUND_STATION)
    assert report.written and report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) <= 0.5
    assert vehicle.body.height_m == pytest.approx(height_m, abs=0.5)
    assert vehicle.firmware.reports.heartbeat().custom_mode == mode


def by_sticks(kind: str) -> CalibrateSettings:
    return CalibrateSettings(writing="yes", turn_by=BY_STICKS[kind])


@pytest.mark.parametrize("kind", [*BY_STICKS, "copter"])
def test_a_vtol_is_a_plane_that_its_rotors_hold(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert found(kind) == ("copter" if kind == "copter" else "vtol")
    monkeypatch.setattr(VehicleProfile, "vtol_state", MavVtolState.FW)
    assert found(kind) == ("copter" if kind == "copter" else "plane")


def found(kind: str) -> str:
    return run(Machine(find_vehicle), SimulatedLink(SimulatedAutopilot(kind, seed=1))).kind


@pytest.mark.parametrize(
    ("state", "said"),
    [(MavVtolState.MC, "--turn-by manual-control"), (MavVtolState.FW, "unless it can hover")],
)
def test_what_it_takes_to_turn_it_is_said(
    state: MavVtolState, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(VehicleProfile, "vtol_state", state)
    vehicle = bent_vehicle("quadplane", seed=11)
    with pytest.raises(Refused, match=said):
        calibrated(vehicle, tmp_path)


class TakenOver(SimulatedAutopilot):
    """Have its mode switched by the pilot while it turns."""

    def advance(self, until_s: float) -> Sequence[Outgoing]:
        said = super().advance(until_s)
        if abs(self.body.yaw_rate_radps) > 0.5:
            self.pilot_switches_mode("HOVER")
        return said


def test_a_pilot_who_changes_its_mode_has_it_back_at_once(tmp_path: Path) -> None:
    vehicle = TakenOver("quadplane", seed=11)
    with pytest.raises(Refused, match="The flight mode was changed to QHOVER"):
        calibrated(vehicle, tmp_path, by_sticks("quadplane"), identity=GROUND_STATION)
    vehicle.advance(vehicle.time_s + 4.0)  # what was overridden last is forgotten
    assert abs(vehicle.body.yaw_rate_radps) < 0.05
    assert vehicle.firmware.reports.heartbeat().custom_mode == PlaneMode.QHOVER
