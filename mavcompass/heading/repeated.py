"""How late a reading is that a compass repeats: by what the vehicle turned since it was new."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.track import Track

# What turns slower may be the gyro's bias: over minutes on a bench that adds up to a circle.
_BIAS_RADPS = math.radians(3.0)


def turned_vector(track: Track, time_s: FloatArray, usual: bool = True) -> FloatArray:
    """Return the sum of the gyro's turns up to some times, (N, 3), radians; zeros without a gyro.

    `usual` False leaves out the rate that most of the recording has, which may be the gyro's bias, too.
    """
    gyro = track.gyro_radps
    if gyro is None or len(gyro) < 3:
        return np.zeros((len(time_s), 3))
    rate = np.nan_to_num(np.asarray(gyro.values))
    rate -= 0.0 if usual else np.median(rate, axis=0)
    rate[np.abs(rate) < _BIAS_RADPS] = 0.0
    turned = np.zeros_like(rate)
    np.cumsum(rate[:-1] * np.diff(gyro.time_s)[:, np.newaxis], axis=0, out=turned[1:])
    return np.stack([np.interp(time_s, gyro.time_s, column) for column in turned.T], axis=1)


def turned_since_new(track: Track, instance: int) -> FloatArray:
    """Return how far the vehicle turned since each reading of a compass was new, (N,), radians.

    Autopilots repeat a reading until the next, and whole numbers repeat at rest; a frozen compass repeats for
    ever. Raises KeyError for a compass that the recording does not have.
    """
    compass = track.compasses[instance]
    values = np.asarray(compass.reported.values)
    new = np.ones(len(values), dtype=bool)
    new[1:] = (values[1:] != values[:-1]).any(axis=1)
    since = np.maximum.accumulate(np.where(new, np.arange(len(values)), 0))
    turned = turned_vector(track, compass.time_s, usual=False)
    return np.asarray(np.linalg.norm(turned - turned[since], axis=1))
