"""The autopilot's own attitude: what steers its yaw, what turns make of that, how late the gyro is."""

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
_AGE_STEP_S, _LONGEST_AGE_S, _LEAST_TURNING_RADPS = 0.01, 0.2, 0.05
# An age that there is leaves half of what none leaves, or less; one that even turns do not show, nearly all.
_LEFT = 0.8


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


def age_of(clock: FloatArray, rate: FloatArray, when: FloatArray, yaw: FloatArray) -> float | None:
    """Return how late a rate (N,) is beside the rate of another yaw (M,), seconds; None where turns hide it.

    What bends that yaw with the heading changes how fast it turns, by sines of it, and not when: of all ages
    that one is right which leaves least beside such a bend.
    """
    step = max(float(np.median(np.diff(clock))), _AGE_STEP_S)
    grid = np.arange(max(clock[0], when[0]), min(clock[-1], when[-1]), step)
    if grid.size < 100:
        return None
    heading = np.interp(grid, when, yaw)
    other = np.gradient(heading, step)
    if float(other.std()) < _LEAST_TURNING_RADPS:
        return None
    lags = np.arange(-_LONGEST_AGE_S, _LONGEST_AGE_S + 1e-9, _AGE_STEP_S)
    edge = round(_LONGEST_AGE_S / step) + 1
    inner = slice(edge, -edge)
    bends = np.stack(
        [np.ones_like(heading), *(f(k * heading) for k in (1, 2) for f in (np.cos, np.sin))], axis=1
    )
    left = []
    for lag in lags:
        design = (np.interp(grid + lag, clock, rate)[:, None] * bends)[inner]
        normal = design.T @ design + 1e-9 * np.eye(bends.shape[1])
        score = design.T @ other[inner]
        left.append(float(other[inner] @ other[inner] - score @ np.linalg.solve(normal, score)))
    best, none = int(np.argmin(left)), int(np.argmin(np.abs(lags)))
    shown = 0 < best < lags.size - 1 and left[best] < _LEFT * left[none]
    return float(lags[best]) if shown else None
