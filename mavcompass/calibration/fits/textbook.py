"""The published methods, as printed, with the robust form where the print is degenerate.

[Skula] D. Skula, "New method for magnetometer offset compensation": eq. 1 to 7.
[Memsense] "nIMU - uIMU Bias and Sensitivity Corrections of Magnetometers", revision 1; its equations
are not numbered.

The two differ in sign and in which axis keeps the scale 1: [Skula] subtracts an offset and scales the
weaker axis up; [Memsense] adds a bias and lets the user choose, advising the stronger axis. Both are
kept. Readings may be in any unit; offsets come back in the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray


@dataclass(frozen=True, slots=True)
class ScaleOffset:
    """Hold [Skula]'s compensation of two axes: H' = H scale - offset (eq. 3)."""

    x_scale: float
    y_scale: float
    x_offset: float
    y_offset: float

    def apply(self, readings: ArrayLike) -> FloatArray:
        """Compensate readings (..., 2) by eq. 3."""
        r = np.asarray(readings, dtype=np.float64)
        return r[..., :2] * (self.x_scale, self.y_scale) - np.array([self.x_offset, self.y_offset])

    def correction(self, z_offset_mgauss: float = 0.0, z_diagonal: float = 1.0) -> FieldCorrection:
        """Express it as a field correction: M (raw + offsets) with M diagonal, offsets = -offset / scale."""
        return FieldCorrection(
            offsets_mgauss=(
                -self.x_offset / self.x_scale,
                -self.y_offset / self.y_scale,
                float(z_offset_mgauss),
            ),
            diagonals=(self.x_scale, self.y_scale, float(z_diagonal)),
        )


def set_reset_offset(set_reading: ArrayLike, reset_reading: ArrayLike) -> Any:
    """Return the offset of a magnetoresistive bridge from readings after set and reset pulses.

    V_off = (V_set + V_reset) / 2, [Skula] eq. 1: the pulse turns the signal's sign over, not the offset's.
    """
    return (np.asarray(set_reading, dtype=np.float64) + np.asarray(reset_reading, dtype=np.float64)) / 2.0


def min_max(readings: ArrayLike) -> ScaleOffset:
    """Compensate two axes by the extremes of a full level turn, readings (N, 2 or 3): [Skula] eq. 2.

    One spike sets an extreme, and a turn that misses a cardinal direction misses one too.
    Raises PoorCalibration where an axis does not change.
    """
    r = np.asarray(readings, dtype=np.float64)[:, :2]
    low, high = r.min(axis=0), r.max(axis=0)
    return _scaled(0.5 * (high - low), low + 0.5 * (high - low))


def _scaled(amplitude: FloatArray, centre: FloatArray) -> ScaleOffset:
    """Scale the weaker axis up to the stronger: "or 1, what is bigger" ([Skula] eq. 2 and 7)."""
    if not (amplitude > 0.0).all():
        raise PoorCalibration(
            "An axis of the compass did not change at all during the turn.",
            "Turn the vehicle all the way round, and check that the compass is alive.",
        )
    x_scale = max(float(amplitude[1] / amplitude[0]), 1.0)
    y_scale = max(float(amplitude[0] / amplitude[1]), 1.0)
    return ScaleOffset(x_scale, y_scale, float(centre[0]) * x_scale, float(centre[1]) * y_scale)


@dataclass(frozen=True, slots=True)
class SensitivityBias:
    """Hold [Memsense]'s correction of two axes: out = sensitivity * in + bias."""

    x_sensitivity: float
    y_sensitivity: float
    x_bias: float
    y_bias: float

    def apply(self, readings: ArrayLike) -> FloatArray:
        """Correct readings (..., 2)."""
        r = np.asarray(readings, dtype=np.float64)
        return r[..., :2] * (self.x_sensitivity, self.y_sensitivity) + np.array([self.x_bias, self.y_bias])

    def correction(self, z_offset_mgauss: float = 0.0, z_diagonal: float = 1.0) -> FieldCorrection:
        """Express it as a field correction: M (raw + offsets), offsets = bias / sensitivity."""
        return FieldCorrection(
            offsets_mgauss=(
                self.x_bias / self.x_sensitivity,
                self.y_bias / self.y_sensitivity,
                float(z_offset_mgauss),
            ),
            diagonals=(self.x_sensitivity, self.y_sensitivity, float(z_diagonal)),
        )


def sensitivity_bias(
    x_min: float,
    x_max: float,
    y_min: float,
    y_max: float,
    unity: Literal["stronger", "x", "y"] = "stronger",
) -> SensitivityBias:
    """Compensate two axes by the extremes of a full level turn, the [Memsense] way.

    `unity` is the axis whose sensitivity is set to one; the paper advises the one with the greater
    response. The other gets the ratio of the spans, and B = S ((max - min) / 2 - max).
    The bicycle of the paper (gauss): X -0.284..0.402, Y -0.322..0.246 gives X 1.000, -0.059 and
    Y 1.208, +0.046.
    Raises PoorCalibration where an axis does not change.
    """
    x_span, y_span = x_max - x_min, y_max - y_min
    if not (x_span > 0.0 and y_span > 0.0):
        raise PoorCalibration(
            "An axis of the compass did not change at all during the turn.",
            "Turn the vehicle all the way round, and check that the compass is alive.",
        )
    x_is_one = unity == "x" or (unity == "stronger" and x_span >= y_span)
    x_s = 1.0 if x_is_one else y_span / x_span
    y_s = x_span / y_span if x_is_one else 1.0
    return SensitivityBias(x_s, y_s, x_s * (0.5 * x_span - x_max), y_s * (0.5 * y_span - y_max))


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


def four_positions_textbook(readings: ArrayLike) -> tuple[ScaleOffset, tuple[FourReadings, FourReadings]]:
    """Compensate two axes from readings (4, 2 or 3) at positions 90 degrees apart: [Skula] eq. 7.

    Returns the compensation and each axis's own solution with its left-over equation.
    Raises PoorCalibration where an axis does not change.
    """
    r = np.asarray(readings, dtype=np.float64)
    x, y = four_readings(r[:, 0]), four_readings(r[:, 1])
    compensation = _scaled(np.array([x.amplitude, y.amplitude]), np.array([x.offset, y.offset]))
    return compensation, (x, y)
