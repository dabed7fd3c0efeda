"""The extremes of a full level turn as sensitivities and biases ([Memsense])."""

from __future__ import annotations

from mavcompass.calibration.fits.textbook import sensitivity_bias
from mavcompass.calibration.methods._level import full_turn, level_result, still_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration for a turn that is not a full one."""
    level = full_turn(recorded)[:, :2]
    (x_min, y_min), (x_max, y_max) = level.min(axis=0), level.max(axis=0)
    compensation = sensitivity_bias(x_min, x_max, y_min, y_max)
    return level_result(recorded, "sensitivity-bias", compensation, still_positions(recorded))
