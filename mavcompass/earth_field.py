"""The Earth's magnetic field where and when the vehicle is, from WMM2025, with its sigma.

The sigmas are those that NOAA states with the model: what the crust and the external field add to
the main field at one place. Declination: sqrt(0.26^2 + (5417 / H)^2) degrees, H in nanotesla.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

import numpy as np

from mavcompass.correction import Vector
from mavcompass.frames import FloatArray
from mavcompass.track import Track
from mavcompass.units import NANOTESLA_PER_MGAUSS, RAD_PER_DEG

MODEL_YEARS = (2025.0, 2030.0)
_SIGMA_MGAUSS = (1.37, 0.89, 1.41)
# Outside the model's five years its secular variation is extrapolated; the acceleration it leaves
# out is of the order of 10 nT per year squared.
_SIGMA_OUTSIDE_MGAUSS_PER_YEAR2 = 0.1
_LAST_UTC_S = 4_102_444_800.0  # 2100


@dataclass(frozen=True, slots=True)
class EarthField:
    """Hold the field vector in NED, milligauss, and the standard deviation of each component."""

    ned_mgauss: Vector
    sigma_mgauss: Vector = _SIGMA_MGAUSS

    @property
    def vector_mgauss(self) -> FloatArray:
        """Return the NED vector as an array of shape (3,)."""
        return np.array(self.ned_mgauss)

    @property
    def horizontal_mgauss(self) -> float:
        """Return the length of the horizontal part."""
        return math.hypot(self.ned_mgauss[0], self.ned_mgauss[1])

    @property
    def total_mgauss(self) -> float:
        """Return the length of the whole field."""
        return math.hypot(*self.ned_mgauss)

    @property
    def declination_rad(self) -> float:
        """Return the angle from true north to magnetic north, east positive."""
        return math.atan2(self.ned_mgauss[1], self.ned_mgauss[0])

    @property
    def declination_sigma_rad(self) -> float:
        """Return the standard deviation of the declination: large near the magnetic poles."""
        horizontal_nt = max(self.horizontal_mgauss * NANOTESLA_PER_MGAUSS, 1.0)
        inherent = self.sigma_mgauss[1] - _SIGMA_MGAUSS[1]
        grown = inherent * NANOTESLA_PER_MGAUSS / horizontal_nt
        model_rad = math.hypot(0.26, 5417.0 / horizontal_nt) * RAD_PER_DEG
        return min(math.hypot(model_rad, grown), math.pi)

    @property
    def inclination_rad(self) -> float:
        """Return the dip: the angle of the field below the horizon."""
        return math.atan2(self.ned_mgauss[2], self.horizontal_mgauss)


def decimal_year(utc_s: float) -> float:
    """Turn a Unix time into a decimal year; what no clock can mean becomes 1970 or 2100."""
    moment = datetime.fromtimestamp(min(max(0.0, utc_s), _LAST_UTC_S), UTC)
    start = datetime(moment.year, 1, 1, tzinfo=UTC)
    end = datetime(moment.year + 1, 1, 1, tzinfo=UTC)
    return moment.year + (moment - start) / (end - start)


@lru_cache(maxsize=1)
def _model() -> Any:
    from pygeomag import GeoMag  # 20 ms and 2 MB: only for those who ask for a field

    return GeoMag()


@lru_cache(maxsize=4096)
def earth_field(lat_deg: float, lon_deg: float, alt_m: float, year: float) -> EarthField:
    """Return the field at a place and a decimal year (WMM2025).

    Outside 2025 to 2030 the secular variation is extrapolated and the sigmas grow.
    Raises ValueError for a place that is not on Earth.
    """
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0 and math.isfinite(alt_m)):
        raise ValueError(f"no such place: latitude {lat_deg}, longitude {lon_deg}, altitude {alt_m} m")
    result = _model().calculate(
        glat=lat_deg, glon=lon_deg, alt=alt_m / 1000.0, time=year, allow_date_outside_lifespan=True
    )
    outside = max(MODEL_YEARS[0] - year, year - MODEL_YEARS[1], 0.0)
    growth = _SIGMA_OUTSIDE_MGAUSS_PER_YEAR2 * outside**2
    x, y, z = (float(v) / NANOTESLA_PER_MGAUSS for v in (result.x, result.y, result.z))
    sx, sy, sz = (s + growth for s in _SIGMA_MGAUSS)
    return EarthField(ned_mgauss=(x, y, z), sigma_mgauss=(sx, sy, sz))


def middle_place(places: FloatArray) -> tuple[float, float, float]:
    """Return the median latitude and longitude, degrees, and altitude of places (N, 3).

    They may lie on either side of the date line. Rows that are not numbers are left out.
    """
    known = np.asarray(places)[np.isfinite(places).all(axis=1)]
    lat, lon, alt = known.T
    if np.ptp(lon) > 180.0:
        lon = np.where(lon < 0.0, lon + 360.0, lon)
    east = float(np.median(lon))
    return float(np.median(lat)), east - 360.0 if east > 180.0 else east, float(np.median(alt))


def earth_field_of(track: Track, year: float | None = None) -> EarthField | None:
    """Return the field at a recording's place and date; None where it does not know its place.

    `year` (decimal) is used where the recording does not know its date; without it the model's first
    year is, and the sigmas are a little too small.
    """
    place = track.place
    if place is None or not len(place):
        return None
    known = np.isfinite(place.values).all(axis=1) & (np.abs(place.values[:, :2]).sum(axis=1) > 1e-6)
    if not known.any():
        return None
    lat, lon, alt = middle_place(place.values[known])
    if track.utc_offset_s is not None:
        year = decimal_year(track.utc_offset_s + float(place.time_s[-1]))
    # A hundredth of a degree or year is far below the model's sigma, and hits the cache.
    return earth_field(round(lat, 2), round(lon, 2), round(alt, -1), round(year or MODEL_YEARS[0], 2))
