"""What steers the autopilot's yaw, what its filter remembers; and faults of gyro and accelerometer.

The smoothed attitude solves for the gyro's bias and scale and for the accelerometer's bias. Every sensor has
some: a fault is what the vehicle did not have when it was good.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from mavcompass.chance import chance_above, chi_square_of
from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.attitude.scatter import Bias
from mavcompass.gap.result import Cause
from mavcompass.simulation.effects import detected_by
from mavcompass.simulation.effects.effect import Detector
from mavcompass.simulation.effects.sampling import first_order_lag
from mavcompass.steering import steering_source
from mavcompass.track import Series, Track

Steering = Literal["own", "other", "unknown"]
# How long a filter remembers what a turn has made of its yaw: one of these about, none tells.
TURN_MEMORIES_S = np.array([2.0, 8.0, 32.0])
# Three axes together, in squared sigmas: as improbable as six sigmas on one of three.
_IMPROBABLE = chi_square_of(6.0 * chance_above(6.0), 3)


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


def sensor_faults(now: Mapping[Detector, Bias], before: Mapping[Detector, Bias]) -> tuple[Cause, ...]:
    """Name what gyro and accelerometer are off by, and were not in the vehicle's baseline."""
    out = []
    for shown in now.keys() & before.keys():
        effect, here, there = detected_by(shown), now[shown], before[shown]
        change, sigma = here.mean - there.mean, np.hypot(here.sigma, there.sigma)
        if np.abs(change).max() >= effect.daily and float(np.sum((change / sigma) ** 2)) >= _IMPROBABLE:
            values, doubts = (dict(zip("xyz", column.tolist(), strict=True)) for column in (change, sigma))
            out.append(Cause.told(effect.id, values, doubts))
    return tuple(sorted(out, key=lambda cause: cause.effect))
