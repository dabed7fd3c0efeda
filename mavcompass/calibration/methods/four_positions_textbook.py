"""Four positions 90 degrees apart, as published ([Skula] eq. 4 to 7)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.fits.textbook import FourReadings, four_positions_textbook
from mavcompass.calibration.methods._level import level_result, still_positions
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, Position
from mavcompass.errors import PoorCalibration
from mavcompass.units import DEG_PER_RAD

_RIGHT_ANGLE_SLACK_RAD = math.radians(30.0)


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration where there are no four such positions."""
    data = still_positions(recorded)
    chosen = _right_angles(data)
    means = np.array([dwell.mean_mgauss for dwell in chosen.dwells])
    compensation, axes = four_positions_textbook(means)
    return level_result(
        recorded, "four-positions-textbook", compensation, data, _positions(chosen), (_left_over(axes),)
    )


def _right_angles(data: FourPositionData | None) -> FourPositionData:
    """Choose the first four positions whose steps are about 90 degrees, all in one direction."""
    if data is not None:
        for first in range(len(data.dwells) - 3):
            steps = data.steps[first : first + 3]
            sense = math.copysign(math.pi / 2.0, steps[0].angle_rad)
            if all(abs(s.angle_rad - sense) < _RIGHT_ANGLE_SLACK_RAD for s in steps):
                return replace(data, dwells=data.dwells[first : first + 4], steps=steps)
    raise PoorCalibration(
        "The recording has no four positions with steps of about 90 degrees between them.",
        "Turn the vehicle in four steps of 90 degrees and stop after each.",
    )


def _left_over(axes: tuple[FourReadings, FourReadings]) -> str:
    x, y = axes
    return (
        f"The two left-over equations give {x.left_over:+.1f} mG on X and {y.left_over:+.1f} mG on Y; "
        "exact steps and an undisturbed field would give 0."
    )


def _positions(data: FourPositionData) -> tuple[Position, ...]:
    return tuple(
        Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples)
        for turned, dwell in zip(data.turned_rad, data.dwells, strict=True)
    )
