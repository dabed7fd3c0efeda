"""One point on a live vehicle: it is left where it stands, written to, read again, and nothing is armed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from bent_vehicles import commands, overheard

from mavcompass import messages as mav
from mavcompass.calibration.result import TrueHeading
from mavcompass.cli.main import main
from mavcompass.enums import MavCmd
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink

MOVES = {MavCmd.COMPONENT_ARM_DISARM, MavCmd.DO_SET_MODE, MavCmd.CONDITION_YAW, MavCmd.NAV_TAKEOFF}


def standing(kind: str, seed: int = 901) -> tuple[SimulatedAutopilot, list[mav.Message]]:
    """A vehicle that has found its position, disarmed, and all that is sent to it."""
    vehicle = SimulatedAutopilot(kind, seed=seed, armed=False)
    vehicle.advance(10.0)
    return vehicle, overheard(vehicle)


def one_point(
    vehicle: SimulatedAutopilot, folder: Path, off_deg: float = 0.0, **more: Any
) -> CalibrationReport:
    heading = TrueHeading(vehicle.truth.yaw_rad + math.radians(off_deg))
    settings = CalibrateSettings(
        writing="yes", method="one-point", true_heading=heading, max_heading_error_deg=8.0, **more
    )
    return calibrate_on(SimulatedLink(vehicle), "sim:test", settings, undo_directory=folder)


# On the ground, afloat, and of the other autopilot: what turns them otherwise does not turn them here.
@pytest.mark.parametrize("kind", ["rover", "boat", "px4-copter"])
def test_it_is_cured_where_it_stands(kind: str, tmp_path: Path) -> None:
    vehicle, heard = standing(kind)
    before_deg = heading_error_rms_deg(vehicle)
    report = one_point(vehicle, tmp_path)
    result = report.results[0]
    assert report.written and report.proof is not None and report.proof.passed
    assert heading_error_rms_deg(vehicle) < 1.96 * result.heading_sigma_deg < 0.6 * before_deg
    assert "no other heading" in report.proof.summary() and report.proof.compasses[0].apart_mgauss < 5.0
    assert not commands(heard) & MOVES and not vehicle.firmware.status.armed
    assert len(report.windows) == 1 and any(tmp_path.iterdir())


def test_values_that_do_not_come_into_force_are_taken_back(tmp_path: Path) -> None:
    """The proof reads the field: a vehicle that keeps correcting by the old values is found out."""
    vehicle, _ = standing("rover")
    vehicle.firmware.compasses.parameters_changed = lambda: None  # type: ignore[method-assign]
    held = vehicle.firmware.compasses.held(1)
    vehicle.firmware.compasses.held = lambda instance: held  # type: ignore[method-assign, assignment]
    report = one_point(vehicle, tmp_path)
    assert report.undone and not report.written
    assert "does not read as the new values must make it" in " ".join(report.messages)


def test_a_heading_that_the_others_contradict_is_not_written(tmp_path: Path) -> None:
    vehicle, _ = standing("boat")
    report = one_point(vehicle, tmp_path, off_deg=120.0, instances=())
    assert not report.accepted and not report.written
    assert all("the heading that was given" in result.reasons[0] for result in report.results)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--true-heading", "30"], "--true-heading is for --method one-point"),
        (["--method", "one-point", "--true-heading-sigma", "2"], "--true-heading-sigma is of --true-heading"),
        (["--method", "one-point", "--motion", "vehicle"], "leaves the vehicle where it stands"),
        (["--method", "one-point", "--yes"], "no second antenna tells it"),
    ],
)
def test_the_command_refuses_what_contradicts_itself(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "sim:rover", *([] if "--yes" in options else ["--dry-run"]), *options]) == 2
    assert says in capsys.readouterr().err
