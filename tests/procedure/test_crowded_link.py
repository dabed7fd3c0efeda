"""Several vehicles, cameras and ground stations on one link: only the one meant is touched."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from bent_vehicles import calibrated

from mavcompass.cli.calibration import Results, calibrate_all
from mavcompass.cli.options import Output
from mavcompass.messages import Message
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink


class Crowd:
    """Put several vehicles on one radio."""

    def __init__(self, *vehicles: SimulatedAutopilot) -> None:
        self.vehicles = vehicles

    @property
    def time_s(self) -> float:
        return self.vehicles[0].time_s

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        for vehicle in self.vehicles:
            vehicle.receive(message, system, component, port)

    def advance(self, until_s: float) -> Sequence[Outgoing]:
        said = [out for vehicle in self.vehicles for out in vehicle.advance(until_s)]
        return sorted(said, key=lambda out: out.time_s)


def vehicle(kind: str, system: int) -> SimulatedAutopilot:
    stations = ((255, 190), (system, 100))
    return SimulatedAutopilot(kind, seed=system, system=system, other_stations=stations)


def test_the_vehicle_that_was_named_is_calibrated_and_the_other_is_left_alone(tmp_path: Path) -> None:
    one, seven = vehicle("rover", 1), vehicle("rover", 7)
    before = dict(one.firmware.store.values)
    yaw_rad = one.body.yaw_rad
    link = SimulatedLink(Crowd(one, seven))
    report = calibrated(one, tmp_path, CalibrateSettings(writing="yes", rate_hz=10.0, system=7), link)
    assert report.identity.system == 7
    assert report.written
    assert heading_error_rms_deg(seven) < 0.5
    changed = {name for name, value in one.firmware.store.values.items() if before[name] != value}
    assert changed <= {"STAT_RUNTIME"}
    assert one.body.yaw_rad == yaw_rad


def test_a_pilot_who_takes_the_other_vehicle_stops_nothing(tmp_path: Path) -> None:
    one, seven = vehicle("rover", 1), vehicle("rover", 7)
    shown: list[str] = []

    class Meanwhile(list[str]):
        def append(self, text: str) -> None:
            super().append(text)
            if text.startswith("Turning to position 2"):
                seven.pilot_switches_mode("MANUAL")
                seven.pilot_moves_stick(1, for_s=20.0)

    shown = Meanwhile()
    settings = CalibrateSettings(writing="yes", rate_hz=10.0, system=1)
    report = calibrated(one, tmp_path, settings, SimulatedLink(Crowd(one, seven)), shown)
    assert report.written and heading_error_rms_deg(one) < 0.5


def test_all_vehicles_are_turned_one_after_the_other_with_one_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))
    one, seven, nine = vehicle("rover", 1), vehicle("rover", 7), vehicle("boat", 9)
    nine.pilot_switches_mode("MANUAL")
    output = Output(str(tmp_path / "all.json"))
    wanted = Results("sim:crowd", output, tmp_path / "new.param")
    link = SimulatedLink(Crowd(nine, seven, one))
    code = calibrate_all(link, wanted, CalibrateSettings(writing="yes", rate_hz=10.0), speak=False)
    document = json.loads((tmp_path / "all.json").read_text())
    assert document["schema"] == "mavcompass.calibrations/1"
    assert [one["system"] for one in document["vehicles"]] == [1, 7, 9]
    assert [one.get("written") for one in document["vehicles"]] == [True, True, None]
    assert document["vehicles"][0]["schema"] == "mavcompass.calibration/1"
    assert "GUIDED" in document["vehicles"][2]["remedy"]
    assert code == document["vehicles"][2]["exit_code"] == 7
    assert heading_error_rms_deg(one) < 0.5 and heading_error_rms_deg(seven) < 0.5
    assert heading_error_rms_deg(nine) > 2.0
    said = capsys.readouterr().out
    assert "ArduPilot rover, system 7: calibrated, written and checked." in said
    assert (tmp_path / "new-system7.param").exists()
    assert "--system 7" in said, "the way back names the vehicle"
