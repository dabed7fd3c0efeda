"""Which way is down, in body axes: gravity for tilt compensation and for turns about the vertical."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.track import Track

GRAVITY_SMOOTHING_S = 0.6
# What stands, or floats, and shows gravity by its accelerometer.
ON_THE_GROUND = frozenset({"rover", "ackermann-rover", "boat"})


def moving_average(time_s: FloatArray, values: FloatArray, width_s: float) -> FloatArray:
    """Average columns, (N, k), over a centred window of a fixed length in time."""
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    first = np.searchsorted(time_s, time_s - width_s / 2.0, side="left")
    last = np.searchsorted(time_s, time_s + width_s / 2.0, side="right")
    return np.asarray((total[last] - total[first]) / (last - first)[:, np.newaxis])


def down_in_body(track: Track, time_s: FloatArray) -> FloatArray:
    """Return the unit vector that points down, in body axes, (N, 3), without using any yaw.

    On the ground the smoothed accelerometer; in flight, where it shows the thrust instead of gravity,
    the autopilot's roll and pitch. Whichever was recorded where only one was; level where neither.
    """
    attitude, acc = track.attitude_rad, track.acc_mps2
    has_attitude = attitude is not None and len(attitude) and np.isfinite(attitude.values[:, :2]).any()
    has_acc = acc is not None and len(acc) and np.isfinite(acc.values).all(axis=1).any()
    if attitude is not None and has_attitude and not (has_acc and track.vehicle in ON_THE_GROUND):
        roll, pitch = attitude.at(time_s)[:, 0], attitude.at(time_s)[:, 1]
        return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    if acc is None or not has_acc:
        return np.tile([0.0, 0.0, 1.0], (time_s.size, 1))
    usable = np.isfinite(acc.values).all(axis=1)
    down = -moving_average(acc.time_s[usable], np.asarray(acc.values)[usable], GRAVITY_SMOOTHING_S)
    columns = [np.interp(time_s, acc.time_s[usable], column) for column in down.T]
    down = np.stack(columns, axis=1)
    return down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-9)
