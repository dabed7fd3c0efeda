"""Four positions 90 degrees apart, as published ([Skula] eq. 4 to 7, see `_level`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.calibration.methods._level import LevelCompensation, level_result, still_positions
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, Position
from mavcompass.errors import PoorCalibration
from mavcompass.units import DEG_PER_RAD

_RIGHT_ANGLE_SLACK_RAD = math.radians(30.0)


@dataclass(frozen=True, slots=True)
class FourReadings:
    """Hold [Skula]'s solution of one axis, H_k = A sin(alpha + 90 k) + c.

    Attributes:
        amplitude, offset: A and c. alpha_rad: the first position's angle.
        left_over: (H1 - H2 + H3 - H4) / 4, which the model makes zero: the free check of step errors and
            of anything that moved.
    """

    amplitude: float
    offset: float
    alpha_rad: float
    left_over: float


def four_readings(readings: ArrayLike) -> FourReadings:
    """Solve one axis from its readings (4,) at four positions 90 degrees apart: [Skula] eq. 4 to 6.

    As printed, alpha = arctan((H1 - H3) / (H2 - H4)) loses the quadrant and A = (H1 - H3) / (2 sin alpha)
    divides by zero at alpha = 0. Here alpha is atan2 of the two differences and A half their length,
    the same numbers where the print works. The printed c uses H1 and H3; here it is the mean of both
    opposite pairs, which halves the noise.
    """
    h1, h2, h3, h4 = (float(v) for v in np.asarray(readings, dtype=np.float64))
    return FourReadings(
        amplitude=0.5 * math.hypot(h1 - h3, h2 - h4),
        offset=0.25 * (h1 + h2 + h3 + h4),
        alpha_rad=math.atan2(h1 - h3, h2 - h4),
        left_over=0.25 * (h1 - h2 + h3 - h4),
    )


def four_positions_textbook(
    readings: ArrayLike,
) -> tuple[LevelCompensation, tuple[FourReadings, FourReadings]]:
    """Compensate two axes from readings (4, 2 or 3) at positions 90 degrees apart: [Skula] eq. 7.

    Returns the compensation and each axis's own solution with its left-over equation.
    Raises PoorCalibration where an axis does not change.
    """
    r = np.asarray(readings, dtype=np.float64)
    x, y = four_readings(r[:, 0]), four_readings(r[:, 1])
    offsets, amplitudes = np.array([x.offset, y.offset]), np.array([x.amplitude, y.amplitude])
    return LevelCompensation.about(offsets, amplitudes), (x, y)


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate X and Y; raises PoorCalibration where there are no four such positions."""
    data = still_positions(recorded)
    chosen = _right_angles(data)
    means = np.array([dwell.mean_mgauss for dwell in chosen.dwells])
    compensation, (x, y) = four_positions_textbook(means)
    left_over = (
        f"The two left-over equations give {x.left_over:+.1f} mG on X and {y.left_over:+.1f} mG on Y; "
        "exact steps and an undisturbed field would give 0."
    )
    positions = tuple(
        Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples)
        for turned, dwell in zip(chosen.turned_rad, chosen.dwells, strict=True)
    )
    return level_result(recorded, "four-positions-textbook", compensation, data, positions, (left_over,))


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
