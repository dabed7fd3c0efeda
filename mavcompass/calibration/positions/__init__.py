"""The four-position calibration: the fit of still positions, what disturbed it, what it cannot tell."""

from __future__ import annotations

from mavcompass.calibration.positions.four_positions import (
    WIDENED_BELOW,
    FourPositionsResult,
    solve_four_positions,
)
from mavcompass.calibration.positions.observability import next_pose, unobserved
from mavcompass.calibration.positions.problem import PositionProblem
from mavcompass.calibration.positions.repeat import repeat_test

__all__ = [
    "WIDENED_BELOW",
    "FourPositionsResult",
    "PositionProblem",
    "next_pose",
    "repeat_test",
    "solve_four_positions",
    "unobserved",
]
