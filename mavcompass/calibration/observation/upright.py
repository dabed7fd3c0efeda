"""Which way is down all through a recording that moves, for a fit of its whole motion.

What an autopilot thinks of roll and pitch is bent where its compass is: it turns what it feels by a wrong
yaw, and holds it against velocities that are right. The accelerometer of what drives feels its bends and
brakes. Newton's law (`sway`) owes nothing to a compass and knows acceleration from gravity. Both are weighed
by what they are worth, reading by reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mavcompass.calibration.observation.sway import LONGEST_GAP_S, level_by_newton
from mavcompass.calibration.observation.tilt import ESTIMATOR_SIGMA_RAD, UPHELD
from mavcompass.frames import FloatArray, tilt_from_acceleration
from mavcompass.heading.gravity import ON_THE_GROUND, down_in_body, moving_average
from mavcompass.track import Series, Track

# What an accelerometer's roll and pitch are off by at rest.
STANDING_SIGMA_RAD = math.radians(0.02)
_WINDOW_S = 20.0
# An autopilot's level errs for as long as this the same way, and more.
_ERRS_FOR_S = 10.0
# A gyro with longer intervals misses what the vehicle did.
_DENSE_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """Hold a recording whose roll and pitch are as good as it tells, and the sigma of each of them, (M,).

    The accelerometer of what drives is left out: its readings are in roll and pitch, for what they are worth.
    """

    track: Track
    sigma_rad: Series


def upright(track: Track) -> Upright | None:
    """Hold what tells roll and pitch against Newton's law, and mend it.

    None where velocities, rates or what is mended were not recorded.
    """
    drives, gyro = track.vehicle in ON_THE_GROUND, track.gyro_radps
    told = track.acc_mps2 if drives else track.attitude_rad
    if track.vehicle in UPHELD - ON_THE_GROUND or not told:
        return None
    if gyro is None or len(gyro) < 3 or float(np.median(np.diff(gyro.time_s))) > _DENSE_S:
        return None
    time, newton, sigma = _by_newton(track, gyro)
    if not np.isfinite(sigma).any():
        return None
    estimate = down_in_body(track, time)
    apart = ((newton - estimate) ** 2).sum(axis=1) / 2.0
    best = STANDING_SIGMA_RAD if drives else ESTIMATOR_SIGMA_RAD
    known = np.isfinite(sigma)
    beyond = np.where(known, apart - sigma**2, 0.0)
    if not drives:
        # An estimate that crosses the truth is not right for that moment.
        sums = moving_average(time, np.stack([beyond, known.astype(float)], axis=1), _ERRS_FOR_S)
        beyond = sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
    doubt = np.sqrt(np.maximum(beyond, best**2))
    weight, others = (sigma**-2)[:, np.newaxis], (doubt**-2)[:, np.newaxis]
    roll, pitch = tilt_from_acceleration(-(weight * newton + others * estimate))
    mended = Series.of(time, np.stack([roll, pitch, np.zeros(time.size)], axis=1))
    return Upright(
        replace(track, attitude_rad=mended, acc_mps2=None if drives else track.acc_mps2),
        Series.of(time, ((weight + others) ** -0.5)[:, 0]),
    )


def _by_newton(track: Track, gyro: Series) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (N,), down in body axes (N, 3) by Newton's law, its sigma (N,): infinite if unknown."""
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for a, b in _windows(gyro.time_s):
        found = level_by_newton(track, a, b)
        if found is not None:
            parts.append((found.time_s, found.down(), found.sigma_rad()))
        else:
            time = gyro.between(a, b).time_s
            parts.append((time, down_in_body(track, time), np.full(time.size, np.inf)))
    times, downs, sigmas = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return times, downs, sigmas


def _windows(time_s: FloatArray) -> list[tuple[float, float]]:
    """List windows of about the same length, none of them across a gap of the gyro."""
    gaps = np.flatnonzero(np.diff(time_s) > LONGEST_GAP_S) + 1
    out: list[tuple[float, float]] = []
    for stretch in np.split(time_s, gaps):
        start, length = float(stretch[0]), float(stretch[-1] - stretch[0])
        out += pairwise(
            np.linspace(start, start + length, max(math.ceil(length / _WINDOW_S), 1) + 1).tolist()
        )
    return out
