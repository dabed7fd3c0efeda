"""The extremes of a full level turn as sensitivities and biases ([Memsense], see `_level`)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mavcompass.calibration.methods._level import (
    LevelCompensation,
    full_turn,
    level_result,
    require_change,
    still_positions,
)
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def sensitivity_bias(
    x_min: float,
    x_max: float,
    y_min: float,
    y_max: float,
    unity: Literal["stronger", "x", "y"] = "stronger",
) -> LevelCompensation:
    """Compensate two axes by the extremes of a full level turn, the [Memsense] way.

    `unity` is the axis whose sensitivity is set to one; the paper advises the one with the greater
    response. The other gets the ratio of the spans, and B = S ((max - min) / 2 - max).
    The bicycle of the paper (gauss): X -0.284..0.402, Y -0.322..0.246 gives X 1.000, -0.059 and
    Y 1.208, +0.046.
    Raises PoorCalibration where an axis does not change.
    """
    x_span, y_span = x_max - x_min, y_max - y_min
    require_change(np.array([x_span, y_span]))
    x_is_one = unity == "x" or (unity == "stronger" and x_span >= y_span)
    x_s = 1.0 if x_is_one else y_span / x_span
    y_s = x_span / y_span if x_is_one else 1.0
    return LevelCompensation((x_s, y_s), (x_s * (0.5 * x_span - x_max), y_s * (0.5 * y_span - y_max)))


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration for a turn that is not a full one."""
    level = full_turn(recorded)[:, :2]
    (x_min, y_min), (x_max, y_max) = level.min(axis=0), level.max(axis=0)
    compensation = sensitivity_bias(x_min, x_max, y_min, y_max)
    return level_result(recorded, "sensitivity-bias", compensation, still_positions(recorded))
