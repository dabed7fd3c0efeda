"""The autopilot's own attitude, which compass its yaw was made from, and what a turn makes of that yaw."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.simulation.effects.sampling import first_order_lag
from mavcompass.track import Series, Track

Steering = Literal["own", "other", "unknown"]
_MOST_COMPASSES = 3
# EK3_SRC1_YAW: satellite receivers (2, 3), external navigation (6), the velocity's direction (8).
_YAW_WITHOUT_COMPASS = (2.0, 3.0, 6.0, 8.0)
# How long a filter remembers what a turn has made of its yaw: one of these about, none tells.
TURN_MEMORIES_S = np.array([2.0, 8.0, 32.0])
# EKF2_MAG_TYPE of PX4: none.
_PX4_NO_COMPASS = (5.0, 6.0)


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
    if track.autopilot == "px4":
        return _px4(track, instance)
    return _ardupilot(track, instance)


def _ardupilot(track: Track, instance: int) -> Steering:
    parameters = track.parameters
    if parameters.get("EK3_SRC1_YAW", 1.0) in _YAW_WITHOUT_COMPASS:
        return "other"
    names = ["COMPASS_USE", *(f"COMPASS_USE{i}" for i in range(2, _MOST_COMPASSES + 1))]
    used = [i for i, name in enumerate(names, start=1) if parameters.get(name, 0.0) != 0.0]
    if names[instance - 1] not in parameters:
        return "unknown"
    if instance not in used:
        return "other"
    return "own" if used[0] == instance else "other"


def _px4(track: Track, instance: int) -> Steering:
    parameters = track.parameters
    if parameters.get("EKF2_MAG_TYPE", 0.0) in _PX4_NO_COMPASS:
        return "other"
    priorities = {
        i: parameters[f"CAL_MAG{i - 1}_PRIO"]
        for i in range(1, _MOST_COMPASSES + 2)
        if f"CAL_MAG{i - 1}_PRIO" in parameters
    }
    if instance not in priorities:
        return "unknown"
    first = max(priorities.values())
    if priorities[instance] <= 0.0 or priorities[instance] < first:
        return "other"
    return "own" if sum(p == first for p in priorities.values()) == 1 else "unknown"
