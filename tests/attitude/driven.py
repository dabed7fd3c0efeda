"""Motions whose roll and pitch are known, as an IMU, a receiver and an autopilot report them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

Way = Literal["circle", "weave", "hard", "stand", "hover"]
_INTERVAL_S, _RECEIVER_S, _LAG_S = 0.04, 0.2, 0.11


def _velocity(way: Way, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the speed and the heading."""
    rate = {
        "circle": np.full(time.size, math.radians(20.0)),
        "weave": math.radians(20.0) * np.where(time // 4.0 % 2.0 == 0.0, 1.0, -1.0),
        "hard": math.radians(40.0) * np.array([0.0, 1.0, 0.0, -1.0])[(time // 3.0).astype(int) % 4],
    }.get(way, np.zeros(time.size))
    speed = {
        "circle": np.full(time.size, 3.0),
        "weave": np.full(time.size, 3.0),
        "hard": np.where(time % 8.0 < 5.0, 5.0, 0.5),
    }.get(way, np.zeros(time.size))
    smooth = np.hanning(round(1.0 / _INTERVAL_S) + 2)
    smooth /= smooth.sum()
    rate, speed = (np.convolve(np.pad(x, smooth.size, mode="edge"), smooth, "same") for x in (rate, speed))
    inside = slice(smooth.size, -smooth.size)
    return speed[inside], np.cumsum(rate[inside]) * _INTERVAL_S


@cache
def driven(
    way: Way, seed: int = 0, seconds: float = 90.0, vehicle: str = "rover", bent_deg: float = 0.0
) -> tuple[Track, FloatArray]:
    """Make a recording and its true down, (N, 3); `bent_deg`: the autopilot's level lags behind as its yaw.

    It leans outward by two degrees to the m/s^2 of its curve, and nods as much as it brakes; a copter leans
    with its thrust.
    """
    chance = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, _INTERVAL_S)
    speed, heading = _velocity(way, time)
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=1)
    if way == "hover":
        velocity = 0.2 * np.stack([np.sin(0.7 * time), np.cos(0.5 * time)], axis=1)
    push = np.gradient(velocity, time, axis=0)
    ahead = push[:, 0] * np.cos(heading) + push[:, 1] * np.sin(heading)
    right = push[:, 1] * np.cos(heading) - push[:, 0] * np.sin(heading)
    stance = np.radians(chance.normal(0.0, 1.0, 2))
    lean = -math.radians(2.0) if vehicle != "copter" else 1.0 / STANDARD_GRAVITY_MPS2
    roll, pitch = stance[0] + lean * right, stance[1] - lean * ahead
    if vehicle == "copter":
        roll, pitch = np.arctan2(right, STANDARD_GRAVITY_MPS2), -np.arctan2(ahead, STANDARD_GRAVITY_MPS2)
    to_world = euler_to_matrix(roll, pitch, heading)
    force = np.column_stack([push, np.full(time.size, -STANDARD_GRAVITY_MPS2)])
    acc = np.einsum("nji,nj->ni", to_world, force) + chance.normal(0.0, 0.05, (time.size, 3))
    acc += chance.normal(0.0, 0.005, 3)
    turn = np.einsum("nji,njk->nik", to_world[:-1], to_world[1:])
    rate = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) / _INTERVAL_S
    rate = np.concatenate([rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]])
    gyro = rate + np.radians(chance.normal(0.0, 0.1, rate.shape) + chance.normal(0.0, 0.1, 3))
    heard = np.arange(0.0, seconds, _RECEIVER_S)
    moved = np.stack([np.interp(heard - _LAG_S, time, column) for column in velocity.T], axis=1)
    moved = moved + chance.normal(0.0, 0.05, moved.shape)
    errs = np.radians(0.1) * chance.normal(0.0, 1.0, 2)
    wrong = bent_deg / 57.3 * np.stack([right, ahead], axis=1) / STANDARD_GRAVITY_MPS2 / 2.0
    told = np.column_stack([roll + errs[0] + wrong[:, 1], pitch + errs[1] + wrong[:, 0], heading])
    track = Track(
        vehicle=vehicle,
        autopilot="ardupilot",
        acc_mps2=Series.of(time, acc),
        gyro_radps=Series.of(time, gyro),
        attitude_rad=Series.of(time[::3], told[::3]),
        receiver_velocity_mps=Series.of(heard, np.column_stack([moved, np.full(heard.size, np.nan)])),
    )
    return track, to_world[:, 2, :]


def without(track: Track, *names: str) -> Track:
    return replace(track, **dict.fromkeys(names))
