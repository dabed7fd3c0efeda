"""The main job, as the first lines of the README promise it, and the figures it is held to."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mavcompass.cli.main import main
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink

WRITE = CalibrateSettings(writing="yes")


@pytest.fixture(autouse=True)
def undo_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path / "undo"))


@cache
def calibrated(seed: int) -> tuple[SimulatedLink, CalibrationReport, float, float]:
    """A badly calibrated rover after a calibration, and its heading error before and after."""
    link = SimulatedLink.of("rover", seed=seed)
    before_deg = heading_error_rms_deg(link.autopilot)
    report = calibrate_on(link, "sim:rover", WRITE)
    return link, report, before_deg, heading_error_rms_deg(link.autopilot)


# As many as wanted: scripts/campaigns/calibration.py.
@pytest.mark.parametrize("seed", [0, 2])
def test_a_badly_calibrated_rover_ends_within_half_a_degree(seed: int) -> None:
    _, report, before_deg, after_deg = calibrated(seed)
    assert before_deg >= 15.0
    assert report.written and report.proof is not None and report.proof.passed
    assert after_deg <= 0.5
    assert report.duration_s <= 30.0


def test_a_second_calibration_moves_the_offsets_by_less_than_two_milligauss() -> None:
    link, first, *_ = calibrated(2)
    second = calibrate_on(link, "sim:rover", WRITE)
    offsets = [report.results[0].correction.offsets_mgauss for report in (first, second)]
    assert np.abs(np.subtract(*offsets)[:2]).max() < 2.0


# The other vehicles: tests/procedure/test_calibrate_vehicles.py.
@pytest.mark.parametrize(("positions", "step_deg"), [(3, 120.0), (4, -90.0), (6, 60.0)])
def test_other_numbers_of_positions_steps_and_directions_are_usable(positions: int, step_deg: float) -> None:
    settings = CalibrateSettings(
        writing="yes", rate_hz=10.0, positions=positions, step_rad=math.radians(step_deg)
    )
    with SimulatedLink.of("rover", seed=5) as link:
        report = calibrate_on(link, "sim:rover", settings)
        assert report.written
        assert heading_error_rms_deg(link.autopilot) <= 0.6


def test_nothing_is_written_on_a_dry_run() -> None:
    with SimulatedLink.of("rover", seed=1) as link:
        before = dict(link.autopilot.firmware.store.storage)
        report = calibrate_on(link, "sim:rover", CalibrateSettings(writing="never"))
        assert report.accepted and not report.written
        assert dict(link.autopilot.firmware.store.storage) == before


# What it says, with the error before and after and the way back: tests/test_docs.py, as in the picture.
def test_the_json_is_the_whole_of_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "sim:rover,seed=2", "--yes", "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "mavcompass.calibration/1"
    assert document["written"] is True and document["verified"] is True
    assert Path(document["undo_file"]).is_file()
    compass = document["compasses"][0]
    assert compass["accepted"] is True and compass["reasons"] == []
    assert compass["parameters"]["COMPASS_OFS_X"] == pytest.approx(-compass["raw_offset_mgauss"][0])
    assert len(compass["positions"]) == 4
    names = {"noise", "step_angle", "tilt", "world_model", "quantisation", "disturbance"}
    assert names <= set(compass["heading_error_budget_deg"])


# What it makes of the firmware's recordings: tests/calibration/test_calibrate_recordings.py.
def test_a_recording_that_hardly_turns_is_refused_with_the_reason(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = str(shared_data / "real" / "px4-ulog" / "sample.ulg")
    assert main(["calibrate", recording, "--json", "-"]) == 5
    said = capsys.readouterr()
    assert "Too little motion" in said.err
    compass = json.loads(said.out)["compasses"][0]
    assert compass["accepted"] is False and "Too little motion" in compass["reasons"][0]
