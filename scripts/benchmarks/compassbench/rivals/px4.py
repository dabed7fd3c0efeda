"""PX4's calibration aboard, rebuilt from what is documented of it (1.14 and later).

Up to 40 readings on each of six sides that lie 0.116 of the radius apart, a side counted once the gyro's
integral passed half a radian on it; a sphere by Levenberg-Marquardt from the world model's radius, then an
ellipsoid. Two sides or fewer give offsets only. The radius must be 200 to 700 mG.
"""

from __future__ import annotations

import numpy as np

from compassbench.cases import STEP_S, Case, columns
from compassbench.rivals import Refusal, Solution
from compassbench.rivals.ardupilot import ellipsoid, sphere, thinned

PER_SIDE, TURNED_RAD, APART = 40, 0.5, 0.116


def solve(case: Case, argument: str = "") -> Solution:
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
