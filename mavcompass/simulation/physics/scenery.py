"""The world drawn by seed: which way the ground slopes, how the waves run."""

from __future__ import annotations

import math

from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.profiles import VehicleProfile
from mavcompass.simulation.physics.world import Place, Wave, World


def draw_world(
    kind: VehicleProfile,
    seed: int,
    place: tuple[float, float, float] | None,
    utc_start_s: float,
    tilt_deg: float | None,
) -> World:
    """Draw a world.

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
