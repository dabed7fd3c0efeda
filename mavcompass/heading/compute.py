"""The heading of a field: level, tilt-compensated, for one sample or a million; from true and grid north.

Body axes are FRD, headings count clockwise from magnetic north. A level vehicle at heading psi sees
the horizontal field H as (H cos psi, -H sin psi), so psi = atan2(-y, x).

From two axes, as Li, Kang, Shu and Yu have it ("Tilt-Induced-Error Compensation for 2-Axis Magnetic Compass
with 2-Axis Accelerometer"), the third is estimated from the field's known length: in this project's axes and
in a form that is safe where the paper's is not; its equations as printed are in
`scripts/reproduction/papers.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, wrap_two_pi

# Rows per block: the working columns of a block stay in the processor's cache.
_BLOCK = 8192


def level_heading(field_mgauss: ArrayLike) -> Any:
    """Return the magnetic heading of a level vehicle, (...), in [0, 2 pi), from fields (..., 2 or 3)."""
    field = np.asarray(field_mgauss, dtype=np.float64)
    return wrap_two_pi(np.arctan2(-field[..., 1], field[..., 0]))


def level_field(heading_rad: ArrayLike, horizontal: ArrayLike, vertical: ArrayLike) -> FloatArray:
    """Return a field as a level vehicle sees it, (..., 3), forward, right, down, at magnetic headings."""
    psi, size = np.asarray(heading_rad, dtype=np.float64), np.asarray(horizontal, dtype=np.float64)
    ahead = size * np.cos(psi)
    field = np.empty((*np.broadcast_shapes(ahead.shape, np.shape(vertical)), 3))
    field[..., 0], field[..., 1], field[..., 2] = ahead, -size * np.sin(psi), vertical
    return field


def tilt_compensated_heading(
    field_mgauss: ArrayLike,
    acc_mps2: ArrayLike | None = None,
    *,
    roll_rad: ArrayLike | None = None,
    pitch_rad: ArrayLike | None = None,
) -> Any:
    """Return the magnetic heading, (...), in [0, 2 pi), from fields (..., 3) and the tilt.

    The tilt comes from the specific force (..., 3) of a vehicle at rest, which reads (0, 0, -g) when
    level, or from roll and pitch (...). With the specific force a and the field f, east is f x a and
    north is a x (f x a), so without any angle

        psi = atan2(|a| (a_z f_y - a_y f_z), f_x (a_y^2 + a_z^2) - a_x (a_y f_y + a_z f_z)).

    Raises ValueError where neither or both are given.
    """
    field = np.asarray(field_mgauss, dtype=np.float64)
    if (acc_mps2 is None) == (roll_rad is None or pitch_rad is None):
        raise ValueError("give either the specific force or roll and pitch")
    if acc_mps2 is None:
        acc = _specific_force(np.asarray(roll_rad, float), np.asarray(pitch_rad, float))
    else:
        acc = np.asarray(acc_mps2, dtype=np.float64)
    field, acc = np.broadcast_arrays(field, acc)
    return _blocks(field.reshape(-1, 3), acc.reshape(-1, 3)).reshape(field.shape[:-1])


def _specific_force(roll: FloatArray, pitch: FloatArray) -> FloatArray:
    cos_pitch = np.cos(pitch)
    return np.stack(
        np.broadcast_arrays(np.sin(pitch), -cos_pitch * np.sin(roll), -cos_pitch * np.cos(roll)), axis=-1
    )


def _blocks(field: FloatArray, acc: FloatArray) -> FloatArray:
    """Work through (N, 3) rows block by block, in place, without temporaries of full length."""
    heading = np.empty(len(field))
    for first in range(0, len(field), _BLOCK):
        rows = slice(first, first + _BLOCK)
        (fx, fy, fz), (ax, ay, az) = field[rows].T.copy(), acc[rows].T.copy()
        east = az * fy
        east -= ay * fz
        along = ay * fy
        along += az * fz
        along *= ax
        for a in (ax, ay, az):
            a *= a
        ay += az
        ax += ay
        east *= np.sqrt(ax, out=ax)
        fx *= ay
        fx -= along
        np.arctan2(east, fx, out=heading[rows])
    np.add(heading, 2.0 * np.pi, out=heading, where=heading < 0.0)
    heading[heading >= 2.0 * np.pi] = 0.0  # -1e-17 + 2 pi rounds to 2 pi itself
    return heading


def true_heading(magnetic_rad: ArrayLike, earth: EarthField) -> Any:
    """Return headings from true north, [0, 2 pi): the magnetic one plus the declination."""
    return wrap_two_pi(np.asarray(magnetic_rad) + earth.declination_rad)


def grid_convergence_rad(lat_deg: float, lon_deg: float) -> float:
    """Return the angle from true north to UTM grid north, clockwise positive.

    tan(gamma) = tan(lon - lon0) sin(lat), lon0 the middle of the zone 6 degrees wide; the terms left
    out are below 0.001 degrees inside a zone. The wider zones of Norway and Svalbard are not known here.
    """
    centre = 6.0 * math.floor((lon_deg + 180.0) / 6.0) - 177.0
    return math.atan(math.tan(math.radians(lon_deg - centre)) * math.sin(math.radians(lat_deg)))


def grid_heading(true_rad: ArrayLike, lat_deg: float, lon_deg: float) -> Any:
    """Return headings from UTM grid north, [0, 2 pi)."""
    return wrap_two_pi(np.asarray(true_rad) - grid_convergence_rad(lat_deg, lon_deg))


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
