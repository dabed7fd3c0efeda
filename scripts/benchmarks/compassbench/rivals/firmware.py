"""The calibrations aboard, rebuilt from what is documented of them.

ArduPilot (firmware 4.x): 300 readings that lie at least 6.3 degrees of the sphere apart, a sphere, then an
ellipsoid of nine parameters by Levenberg-Marquardt; accepted with a residual below 16 mG (COMPASS_CAL_FIT),
a radius of 150 to 950 mG, offsets below 1800 mG (COMPASS_OFFS_MAX), diagonals of 0.2 to 5 and off-diagonals
below 1. The field's length there by the world model scales the result (COMPASS_SCALE), if by 0.67 to 1.5.

PX4 (1.14 and later): up to 40 readings on each of six sides that lie 0.116 of the radius apart, a side
counted once the gyro's integral passed half a radian on it; a sphere by Levenberg-Marquardt from the world
model's radius, then an ellipsoid. Two sides or fewer give offsets only. The radius must be 200 to 700 mG.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from compassbench.cases import STEP_S, Case, columns
from compassbench.rivals import F, Refusal, Solution

SAMPLES, APART_RAD, FIRST_RADIUS = 300, math.radians(6.3), 200.0
PER_SIDE, TURNED_RAD, APART = 40, 0.5, 0.116


def solve(case: Case, argument: str = "ardupilot") -> Solution:
    """Calibrate as a vehicle would that is moved in this way once."""
    return {"ardupilot": ardupilot, "px4": px4}[argument](case)


def thinned(readings: F, apart: float, most: int) -> F:
    """Take readings in their order that lie at least so far from all that are taken."""
    taken = np.empty((most, 3))
    count = 0
    for reading in readings:
        if count == most:
            break
        if not count or float(((taken[:count] - reading) ** 2).sum(axis=1).min()) >= apart**2:
            taken[count], count = reading, count + 1
    return taken[:count]


def symmetric(six: F) -> F:
    """Return the matrix of its diagonal and off-diagonals xy, xz, yz."""
    x, y, z, xy, xz, yz = six
    return np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def sphere(readings: F, radius: float = FIRST_RADIUS) -> tuple[F, float]:
    """Fit offset (to be added) and radius."""
    start = np.array([*-readings.mean(axis=0), radius])
    fitted = least_squares(lambda p: np.linalg.norm(readings + p[:3], axis=1) - p[3], start, method="lm").x
    return fitted[:3], abs(float(fitted[3]))


def ellipsoid(readings: F, offset: F, radius: float) -> tuple[F, F, float]:
    """Fit offset and symmetric matrix that bring the readings to a radius; return the residual, too."""
    start = np.array([*offset, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])

    def residual(p: F) -> F:
        return np.linalg.norm((readings + p[:3]) @ symmetric(p[3:]), axis=1) - radius

    found = least_squares(residual, start, method="lm", max_nfev=2000)
    return found.x[:3], symmetric(found.x[3:]), math.sqrt(float((found.fun**2).mean()))


def ardupilot(case: Case) -> Solution:
    """Calibrate by what readings there are."""
    apart = 2.0 * math.sin(APART_RAD / 2.0)
    first = thinned(case.mag, apart * FIRST_RADIUS, SAMPLES)
    if len(first) < SAMPLES:
        raise Refusal(f"{len(first)} of {SAMPLES} readings: it waits for more")
    _, radius = sphere(first)
    readings = thinned(case.mag, apart * radius, SAMPLES)
    if len(readings) < SAMPLES:
        raise Refusal(f"{len(readings)} of {SAMPLES} readings after thinning: it waits for more")
    offset, radius = sphere(readings)
    offset, matrix, rms = ellipsoid(readings, offset, radius)
    off = matrix[np.triu_indices(3, 1)]
    sound = 150.0 < radius < 950.0 and np.abs(offset).max() < 1800.0 and np.abs(off).max() < 1.0
    sound = sound and 0.2 < np.diag(matrix).min() and np.diag(matrix).max() < 5.0
    if rms > 16.0 or not sound:
        raise Refusal(f"fit of {rms:.0f} mG, radius {radius:.0f} mG")
    scale = float(np.linalg.norm(case.world)) / radius
    return Solution(offset, matrix * (scale if 1 / 1.5 < scale < 1.5 else 1.0))


def px4(case: Case) -> Solution:
    """Calibrate by the sides that this motion shows."""
    force = columns(case.mag_time, case.time, case.acc)
    side = 2 * np.abs(force).argmax(axis=1) + (force[np.arange(len(force)), np.abs(force).argmax(axis=1)] > 0)
    turning = columns(case.mag_time, case.time, np.cumsum(case.gyro, axis=0) * STEP_S)
    world = float(np.linalg.norm(case.world))
    taken = []
    for one in range(6):
        on = side == one
        if on.sum() > 3 and np.ptp(turning[on], axis=0).max() > TURNED_RAD:
            taken.append(thinned(case.mag[on], APART * world, PER_SIDE))
    if not taken:
        raise Refusal("no rotation seen on any side")
    readings = np.concatenate(taken)
    if len(readings) < 4:
        raise Refusal("too few readings")
    offset, radius = sphere(readings, world)
    if not 200.0 < radius < 700.0:
        raise Refusal(f"radius {radius:.0f} mG")
    if len(taken) <= 2:
        return Solution(offset)
    offset, matrix, _ = ellipsoid(readings, offset, radius)
    if not np.isfinite(matrix).all() or np.diag(matrix).min() <= 0.0:
        raise Refusal("scale not positive")
    return Solution(offset, matrix)
