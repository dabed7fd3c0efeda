"""From magnetic north to true and to grid north."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.earth_field import EarthField
from mavcompass.frames import wrap_two_pi


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
