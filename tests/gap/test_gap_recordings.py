"""The diagnosis on recordings that our simulator never made."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavcompass.gap import diagnose_gap
from mavcompass.gap.export import ardupilot_sitl, settings_of
from mavcompass.logs import read_track


def test_firmware_recording_gives_back_the_simulators_parameters(shared_data: Path) -> None:
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_dist_use2.tlog")
    diagnosis = diagnose_gap(track)
    assert diagnosis.effects == {"hard_iron", "axis_scale"}
    assert diagnosis.reference == "gyro"
    assert diagnosis.field.after < diagnosis.field.floor
    exported = ardupilot_sitl(settings_of(diagnosis.causes)).parameters
    for axis, offset, diagonal in (("X", 120.0, 1.1), ("Y", -80.0, 0.9), ("Z", 40.0, 1.0)):
        assert exported[f"SIM_MAG1_OFS_{axis}"] == pytest.approx(offset, rel=0.02)
        assert exported[f"SIM_MAG1_DIA_{axis}"] == pytest.approx(diagonal, rel=0.02)


def test_offsets_of_an_untouched_firmware_simulator_are_found(shared_data: Path) -> None:
    """The firmware's simulator comes with offsets (5, 13, -18) that its calibration undoes."""
    diagnosis = diagnose_gap(read_track(shared_data / "ardupilot-4.6.3" / "rover_plain.tlog"))
    assert diagnosis.effects == {"hard_iron"}
    cause = diagnosis.causes[0]
    for axis, true in zip("xyz", (-5.0, -13.0, 18.0), strict=True):
        low, high = cause.ci95[axis]
        assert low < true < high and high - low < 8.0
        assert cause.parameters[axis] == pytest.approx(true, abs=2.0)
