"""The world a simulated vehicle stands in: the place, the Earth's field, the ground, the water."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mavcompass.correction import Vector
from mavcompass.earth_field import decimal_year, earth_field
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.profiles import Place, VehicleProfile

EARTH_RADIUS_M = 6_371_000.0

# 2026-06-01 00:00 UTC: inside the years of the field model, and the same on every run.
DEFAULT_UTC_S = 1_780_272_000.0


@dataclass(frozen=True, slots=True)
class Wave:
    """Describe one sine of the water's tilt: amplitude, angular frequency, phase (all radians)."""

    amplitude_rad: float
    frequency_radps: float
    phase_rad: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return tilt and tilt rate."""
        angle = self.frequency_radps * time_s + self.phase_rad
        return (
            self.amplitude_rad * math.sin(angle),
            self.amplitude_rad * self.frequency_radps * math.cos(angle),
        )


@dataclass(frozen=True, slots=True)
class World:
    """Hold what is around the vehicle.

    Attributes:
        slope: how much the ground rises per metre to the north and to the east.
        roll_waves, pitch_waves: how the water tilts a boat.
        field_ned_mgauss, declination_rad: computed from the world model for place and time.
    """

    place: Place
    utc_start_s: float = DEFAULT_UTC_S
    slope: tuple[float, float] = (0.0, 0.0)
    roll_waves: tuple[Wave, ...] = ()
    pitch_waves: tuple[Wave, ...] = ()
    field_ned_mgauss: Vector = field(init=False)
    declination_rad: float = field(init=False)

    def __post_init__(self) -> None:
        earth = earth_field(
            self.place.lat_deg, self.place.lon_deg, self.place.alt_m, decimal_year(self.utc_start_s)
        )
        object.__setattr__(self, "field_ned_mgauss", earth.ned_mgauss)
        object.__setattr__(self, "declination_rad", earth.declination_rad)

    @property
    def horizontal_mgauss(self) -> float:
        """Return the length of the field's horizontal part."""
        return math.hypot(self.field_ned_mgauss[0], self.field_ned_mgauss[1])

    def ground_tilt(self, yaw_rad: float, yaw_rate_radps: float) -> tuple[float, float, float, float]:
        """Return roll, pitch and their rates of a vehicle standing on the slope at a yaw."""
        north, east = self.slope
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        ahead, right = north * c + east * s, -north * s + east * c
        pitch = math.atan(ahead)
        level = math.cos(pitch)
        # `right` is also the derivative of `ahead` by yaw, and minus `ahead` that of `right`.
        pitch_rate = yaw_rate_radps * right * level * level
        across = right * level
        roll = -math.atan(across)
        across_rate = -yaw_rate_radps * ahead * level - right * math.sin(pitch) * pitch_rate
        roll_rate = -across_rate / (1.0 + across * across)
        return roll, pitch, roll_rate, pitch_rate

    def water_tilt(self, time_s: float) -> tuple[float, float, float, float]:
        """Return roll, pitch and their rates of a boat in the waves."""
        roll = roll_rate = pitch = pitch_rate = 0.0
        for wave in self.roll_waves:
            tilt, rate = wave.at(time_s)
            roll, roll_rate = roll + tilt, roll_rate + rate
        for wave in self.pitch_waves:
            tilt, rate = wave.at(time_s)
            pitch, pitch_rate = pitch + tilt, pitch_rate + rate
        return roll, pitch, roll_rate, pitch_rate

    def position_to_place(self, north_m: float, east_m: float, down_m: float) -> Place:
        """Turn a position relative to the start into a place (flat Earth: metres to a kilometre)."""
        here = self.place
        return Place(
            lat_deg=here.lat_deg + math.degrees(north_m / EARTH_RADIUS_M),
            lon_deg=here.lon_deg
            + math.degrees(east_m / (EARTH_RADIUS_M * math.cos(math.radians(here.lat_deg)))),
            alt_m=here.alt_m - down_m,
        )


def draw_world(
    kind: VehicleProfile,
    seed: int,
    place: tuple[float, float, float] | None,
    utc_start_s: float,
    tilt_deg: float | None,
) -> World:
    """Draw which way the ground slopes and how the waves run.

    Parameters
    ----------
    kind: the vehicle, which brings its usual place and the steepness of ground it drives on.
    place: latitude deg, longitude deg, altitude m, or None for the usual one.
    tilt_deg: steepness of the ground, height of the waves as tilt; by seed if None.
    """
    rng = generator(seed, "ground")
    heading, steepness = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.4, 1.0)
    slope_rad, wave_rad = kind.slope_rad * steepness, kind.wave_rad * steepness
    if tilt_deg is not None:
        slope_rad = wave_rad = math.radians(tilt_deg)
    waves: list[tuple[Wave, ...]] = [(), ()]
    if kind.chassis == "boat":
        slope_rad = 0.0
        for axis, share in enumerate((1.0, 0.6)):
            waves[axis] = tuple(
                Wave(wave_rad * share * part, 2.0 * math.pi / period, rng.uniform(0.0, 2.0 * math.pi))
                for part, period in ((0.7, rng.uniform(2.6, 3.4)), (0.3, rng.uniform(1.3, 1.9)))
            )
    rise = math.tan(slope_rad)
    return World(
        Place(*place) if place else kind.place,
        utc_start_s,
        slope=(rise * math.cos(heading), rise * math.sin(heading)),
        roll_waves=waves[0],
        pitch_waves=waves[1],
    )
