"""A heading from two magnetic axes: the third is estimated from the field's known length.

Li, Kang, Shu, Yu, "Tilt-Induced-Error Compensation for 2-Axis Magnetic Compass with 2-Axis
Accelerometer", in this project's axes and in a form that is safe where the paper's is not; its equations as
they are printed are in `scripts/reproduction/tilt_figures.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.heading.compute import tilt_compensated_heading

_LEVEL_RAD = math.radians(2.0)
_GAIN = 0.02


def two_axis_heading(
    field_xy_mgauss: ArrayLike,
    roll_rad: ArrayLike,
    pitch_rad: ArrayLike,
    total_mgauss: ArrayLike,
    inclination_rad: float,
) -> Any:
    """Return the magnetic heading of a two-axis compass in FRD axes, (...), [0, 2 pi).

    Args:
        field_xy_mgauss: corrected field on X and Y, (..., 2).
        roll_rad, pitch_rad: aerospace tilt, (...).
        total_mgauss: length of the Earth's field, a number or (...).
        inclination_rad: its dip, positive where it points down: chooses the root.

    The vertical part V of the field must come out as total sin(inclination). Of the two roots
    Z = +-sqrt(F^2 - X^2 - Y^2) the one is taken whose V is nearer to that: the one that adds to V where X and
    Y lack some of it. With the vehicle upright and the dip well off zero it is the hemisphere's sign. Where
    noise makes the root's argument negative, the field lies in the sensor's plane and Z is 0.
    """
    field = np.asarray(field_xy_mgauss, dtype=np.float64)
    x, y = field[..., 0], field[..., 1]
    roll, pitch = np.asarray(roll_rad, float), np.asarray(pitch_rad, float)
    total = np.asarray(total_mgauss, dtype=np.float64)
    size = np.sqrt(np.maximum(total**2 - x**2 - y**2, 0.0))  # eq. 2
    wanted = total * math.sin(inclination_rad)
    across = -np.sin(pitch) * x + np.cos(pitch) * np.sin(roll) * y
    z = np.copysign(size, (wanted - across) * np.cos(roll))
    return tilt_compensated_heading(
        np.stack(np.broadcast_arrays(x, y, z), axis=-1), roll_rad=roll, pitch_rad=pitch
    )


class TwoAxisCompass:
    """Follow the field's length with a two-axis compass: the paper's step 5, "H_earth is updated".

    At each reading taken level (both angles below 2 degrees) the horizontal length is measured
    directly, and the total length is moved toward sqrt(horizontal^2 + vertical^2), the vertical part
    being the world model's. The paper does not say how it updates; this is the form used here.
    """

    def __init__(self, total_mgauss: float, inclination_rad: float) -> None:
        self.total_mgauss = total_mgauss
        self._vertical = total_mgauss * math.sin(inclination_rad)

    def update(self, x_mgauss: float, y_mgauss: float, roll_rad: float, pitch_rad: float) -> float:
        """Take one reading and return the magnetic heading, [0, 2 pi)."""
        if max(abs(roll_rad), abs(pitch_rad)) < _LEVEL_RAD:
            measured = math.sqrt(x_mgauss**2 + y_mgauss**2 + self._vertical**2)
            self.total_mgauss += _GAIN * (measured - self.total_mgauss)
        inclination = math.asin(max(-1.0, min(1.0, self._vertical / self.total_mgauss)))
        field = (x_mgauss, y_mgauss)
        return float(two_axis_heading(field, roll_rad, pitch_rad, self.total_mgauss, inclination))
