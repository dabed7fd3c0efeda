"""The extremes of a full level turn, the weaker axis scaled up to the stronger ([Skula] eq. 2)."""

from __future__ import annotations

from mavcompass.calibration.fits.textbook import min_max
from mavcompass.calibration.methods._level import full_turn, level_result, still_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration for a turn that is not a full one."""
    return level_result(recorded, "min-max", min_max(full_turn(recorded)), still_positions(recorded))
