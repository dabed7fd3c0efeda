"""A heading from two magnetic axes: the third is estimated from the field's known length.

Li, Kang, Shu, Yu, "Tilt-Induced-Error Compensation for 2-Axis Magnetic Compass with 2-Axis
Accelerometer". The paper's equations stand here as they are printed (`paper_*`), and a form in this
project's axes that is safe where the paper's is not.

The paper's axes: X forward, Z along the magnetometer's third axis, azimuth arctan(Y / X), which is
clockwise from north only if Y counts to the LEFT (its text says right; with Y to the right the same
formula gives minus the heading). Its roll theta and pitch phi turn the measured vector back to the
horizontal, so they have the opposite sign of a right-handed rotation of the vehicle: theta = -roll
and phi = -pitch for right-handed X forward, Y left, Z up, and equally for forward, right, down.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.frames import FloatArray, wrap_two_pi
from mavcompass.heading.compute import tilt_compensated_heading

_LEVEL_RAD = math.radians(2.0)
_GAIN = 0.02


def paper_azimuth(x: ArrayLike, y: ArrayLike) -> Any:
    """Return the level two-axis azimuth (eq. 1 and 6), [0, 2 pi); atan2 in place of arctan(Y / X)."""
    return wrap_two_pi(np.arctan2(y, x))


def paper_vertical(x: ArrayLike, y: ArrayLike, length: ArrayLike, sign: float = 1.0) -> Any:
    """Estimate the third axis from the field's length (eq. 2, printed again as eq. 3).

    Z = sign sqrt(length^2 - X^2 - Y^2). The paper gives the positive root only; which one is right
    depends on hemisphere and axes (`sign`). Where noise makes the difference negative, Z is 0.
    """
    left = np.asarray(length, float) ** 2 - np.asarray(x, float) ** 2 - np.asarray(y, float) ** 2
    return sign * np.sqrt(np.maximum(left, 0.0))


def paper_level_field(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, theta_rad: ArrayLike, phi_rad: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn a field to the horizontal by roll theta (eq. 4), then pitch phi (eq. 5): Xh, Yh, Zv."""
    x, y, z = (np.asarray(v, dtype=np.float64) for v in (x, y, z))
    theta, phi = np.asarray(theta_rad, float), np.asarray(phi_rad, float)
    y_roll = y * np.cos(theta) + z * np.sin(theta)
    z_roll = -y * np.sin(theta) + z * np.cos(theta)
    x_level = x * np.cos(phi) - z_roll * np.sin(phi)
    return x_level, y_roll, x * np.sin(phi) + z_roll * np.cos(phi)


def paper_two_axis_azimuth(
    x: ArrayLike,
    y: ArrayLike,
    theta_rad: ArrayLike,
    phi_rad: ArrayLike,
    length: ArrayLike,
    sign: float = 1.0,
) -> Any:
    """Return the tilt-compensated azimuth of a two-axis compass (eq. 2, 4, 5, 6), [0, 2 pi)."""
    z = paper_vertical(x, y, length, sign)
    x_level, y_level, _ = paper_level_field(x, y, z, theta_rad, phi_rad)
    return paper_azimuth(x_level, y_level)


def vertical_error_bound_rad(vertical_error_mgauss: float, horizontal_mgauss: float) -> float:
    """Return the paper's bound of the azimuth error by a wrong Z: both level components off by it.

    atan(sqrt(2) dZ / H): 0.8 degrees for 2 mG at 200 mG.
    """
    return math.atan(math.sqrt(2.0) * vertical_error_mgauss / horizontal_mgauss)


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
    size = paper_vertical(x, y, total_mgauss)
    wanted = np.asarray(total_mgauss, float) * math.sin(inclination_rad)
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
