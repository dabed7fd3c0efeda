"""The autopilot's own attitude, which compass its yaw was made from, and what a turn makes of that yaw."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.simulation.effects.sampling import first_order_lag
from mavcompass.steering import steering_source
from mavcompass.track import Series, Track

Steering = Literal["own", "other", "unknown"]
# How long a filter remembers what a turn has made of its yaw: one of these about, none tells.
TURN_MEMORIES_S = np.array([2.0, 8.0, 32.0])


def told_rotation(attitude_rad: Series, time_s: FloatArray) -> FloatArray:
    """Return the autopilot's attitude (roll, pitch, yaw) at other times, as rotations (N, 3, 3)."""
    when, first = np.unique(attitude_rad.time_s, return_index=True)
    roll, pitch, yaw = attitude_rad.values[first].T
    angles = Series.of(when, np.stack([roll, pitch, np.unwrap(yaw)], axis=1)).at(time_s)
    return euler_to_matrix(*angles.T)


def remembered_turns(time_s: FloatArray, turned_rad: FloatArray) -> FloatArray:
    """Return how far a vehicle has turned (N,) less what a filter forgot of it, for each memory, (N, 3).

    An autopilot integrates the gyro, whose scale s is off, and follows a compass that is late: its yaw errs
    by e' = s w - (e + late w) / T, which is s - late / T times what is returned here.
    """
    turned = turned_rad[:, None]
    forgotten = [first_order_lag(time_s, turned, memory_s)[0] for memory_s in TURN_MEMORIES_S]
    return np.asarray(turned - np.hstack(forgotten))


def steered_by(track: Track, instance: int) -> Steering:
    """Tell from the parameters whether the compass under test steers the autopilot's yaw."""
    source = steering_source(track.autopilot, track.parameters)
    if source is None:
        return "unknown"
    return "own" if source == instance else "other"
