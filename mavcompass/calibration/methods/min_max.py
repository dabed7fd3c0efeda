"""The extremes of a full level turn, the weaker axis scaled up to the stronger ([Skula], see `_level`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.methods._level import LevelCompensation, full_turn, level_result, still_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def set_reset_offset(set_reading: ArrayLike, reset_reading: ArrayLike) -> Any:
    """Return the offset of a magnetoresistive bridge from readings after set and reset pulses.

    V_off = (V_set + V_reset) / 2, [Skula] eq. 1: the pulse turns the signal's sign over, not the offset's.
    """
    return (np.asarray(set_reading, dtype=np.float64) + np.asarray(reset_reading, dtype=np.float64)) / 2.0


def min_max(readings: ArrayLike) -> LevelCompensation:
    """Compensate two axes by the extremes of a full level turn, readings (N, 2 or 3): [Skula] eq. 2.

    One spike sets an extreme, and a turn that misses a cardinal direction misses one too.
    Raises PoorCalibration where an axis does not change.
    """
    r = np.asarray(readings, dtype=np.float64)[:, :2]
    low, high = r.min(axis=0), r.max(axis=0)
    return LevelCompensation.about(low + 0.5 * (high - low), 0.5 * (high - low))


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration for a turn that is not a full one."""
    return level_result(recorded, "min-max", min_max(full_turn(recorded)), still_positions(recorded))
