"""The ways that vehicles go: roll, pitch and yaw over time, and what speeds them up. numpy alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
RNG = np.random.Generator
STEP_S, GRAVITY = 0.02, 9.80665


def columns(at: F, time: F, values: F) -> F:
    """Interpolate each column of (N, k)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def matrices(euler: F) -> F:
    """Return the rotations from body to world, (N, 3, 3), of roll, pitch, yaw."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler).T, np.sin(euler).T
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def smooth(values: F, seconds: float) -> F:
    """Average over a window, twice, so that rates are smooth as well."""
    width = max(int(seconds / STEP_S) | 1, 1)
    for _ in range(2):
        values = np.convolve(np.pad(values, width // 2, mode="edge"), np.ones(width) / width, mode="valid")
    return values


def wander(rng: RNG, count: int, sigma: float, knots_s: float) -> F:
    """Return something that wanders about zero, a new value every so many seconds."""
    knots = rng.normal(0.0, sigma, int(count * STEP_S / knots_s) + 3)
    return np.interp(np.arange(count) * STEP_S / knots_s, np.arange(knots.size), knots)


@dataclass
class Motion:
    """Hold roll, pitch, yaw (N, 3); acceleration and velocity in the world (N, 3); effort (N,), 0 to 1."""

    euler: F
    acceleration: F
    velocity: F
    effort: F


def _standing(yaw: F, rng: RNG, ground_deg: float) -> Motion:
    """Turn on the spot, on ground that leans a little."""
    lean, to = math.radians(abs(rng.normal(0.0, ground_deg))), rng.uniform(0.0, 2.0 * math.pi)
    roll, pitch = lean * np.sin(to - yaw), -lean * np.cos(to - yaw)
    still = np.zeros((yaw.size, 3))
    turning = np.abs(np.gradient(yaw, STEP_S))
    return Motion(np.stack([roll, pitch, yaw], axis=1), still, still, turning / max(turning.max(), 1e-9))


def _ramp(start: float, by: float, rate_deg: float) -> F:
    count = max(int(1.5 * abs(math.degrees(by)) / rate_deg / STEP_S), 2)
    return start + by * (0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, count)))


def turn(rng: RNG, stops: int = 0) -> Motion:
    """Four or five stops about 90 degrees apart, or one to two slow circles, on the level."""
    yaw = [np.full(int(5.0 / STEP_S), rng.uniform(0.0, 2.0 * math.pi))]
    way = rng.choice([-1.0, 1.0])
    if stops or rng.random() < 0.5:
        for _ in range((stops or int(rng.integers(4, 6))) - 1):
            step = way * math.radians(90.0 + rng.normal(0.0, 5.0))
            ramp = _ramp(yaw[-1][-1], step, rng.uniform(20.0, 45.0))
            yaw += [ramp, np.full(int(5.0 / STEP_S), ramp[-1])]
    else:
        ramp = _ramp(yaw[-1][-1], way * math.radians(rng.uniform(370.0, 720.0)), rng.uniform(10.0, 25.0))
        yaw += [ramp, np.full(int(5.0 / STEP_S), ramp[-1])]
    return _standing(np.concatenate(yaw), rng, 0.7)


def little(rng: RNG) -> Motion:
    """Swing by 10 to 40 degrees in all and stop there: too little for anybody."""
    first = rng.uniform(0.0, 2.0 * math.pi)
    yaw, reach = [np.full(int(5.0 / STEP_S), first)], math.radians(rng.uniform(10.0, 40.0))
    for share in (1.0, rng.uniform(0.0, 0.5), rng.uniform(0.5, 1.0), 0.0):
        ramp = _ramp(yaw[-1][-1], first + share * reach - yaw[-1][-1], 20.0)
        yaw += [ramp, np.full(int(5.0 / STEP_S), ramp[-1])]
    return _standing(np.concatenate(yaw), rng, 0.7)


def leaning(rng: RNG) -> Motion:
    """Stop eight times at any heading, leaning by up to 30 degrees, and go from one to the next slowly."""
    stops = np.stack([rng.uniform(-0.5, 0.5, 8), rng.uniform(-0.5, 0.5, 8), rng.uniform(0.0, 6.3, 8)], axis=1)
    held = np.repeat(stops, int(8.0 / STEP_S), axis=0)
    euler = np.stack([smooth(column, 2.0) for column in held.T], axis=1)
    still = np.zeros((len(euler), 3))
    return Motion(euler, still, still, np.zeros(len(euler)))


def hand(rng: RNG) -> Motion:
    """Turn by hand all over the sphere for 90 s, after 3 s on the ground."""
    count = int(93.0 / STEP_S)
    begin = np.clip((np.arange(count) * STEP_S - 3.0) / 2.0, 0.0, 1.0)
    rates = np.stack([smooth(wander(rng, count, 1.0, 2.0), 0.5) * begin for _ in range(3)], axis=1)
    rates *= math.radians(rng.uniform(55.0, 80.0)) / np.sqrt((rates**2).mean())
    attitude = matrices(np.array([[0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)]]))[0]
    euler = np.empty((count, 3))
    for k, angle in enumerate(rates * STEP_S):
        euler[k] = (
            math.atan2(attitude[2, 1], attitude[2, 2]),
            -math.asin(max(-1.0, min(1.0, attitude[2, 0]))),
            math.atan2(attitude[1, 0], attitude[0, 0]),
        )
        attitude = attitude @ _rodrigues(angle)
    shaken = np.stack([smooth(rng.normal(0.0, 1.0, count), 0.3) * begin for _ in range(3)], axis=1)
    shaken *= rng.uniform(0.3, 1.0) / max(shaken.std(), 1e-9)
    return Motion(euler, shaken, np.zeros((count, 3)), np.zeros(count))


def _rodrigues(angle: F) -> F:
    x, y, z = angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    size = math.sqrt(x * x + y * y + z * z) + 1e-12
    return np.eye(3) + math.sin(size) / size * cross + (1.0 - math.cos(size)) / size**2 * (cross @ cross)


def _legs(rng: RNG, length_s: float) -> tuple[F, F]:
    """Return yaw rate and speed of an ordinary way: legs, bends, now and then a stop."""
    rate: list[F] = []
    speed: list[F] = []
    while sum(map(len, rate)) * STEP_S < length_s:
        pace = rng.uniform(1.0, 4.0) if rng.random() > 0.1 else 0.0
        turning = rng.choice([-1.0, 1.0]) * math.radians(rng.uniform(10.0, 40.0))
        bend_s = math.radians(rng.uniform(30.0, 150.0)) / abs(turning)
        for lasts, rate_now in ((rng.uniform(3.0, 10.0), 0.0), (bend_s, turning if pace else 0.0)):
            rate.append(np.full(max(int(lasts / STEP_S), 1), rate_now))
            speed.append(np.full(rate[-1].size, pace))
    return smooth(np.concatenate(rate), 0.6), smooth(np.concatenate(speed), 1.0)


def drive(rng: RNG) -> Motion:
    """Drive for 150 s over uneven ground; the accelerometer feels bends and braking."""
    rate, speed = _legs(rng, 150.0)
    yaw = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(rate) * STEP_S
    roll, pitch = (smooth(wander(rng, yaw.size, math.radians(3.0), 6.0), 0.5) for _ in range(2))
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(yaw.size)], axis=1)
    return Motion(
        np.stack([roll, pitch, yaw], axis=1),
        np.gradient(velocity, STEP_S, axis=0),
        velocity,
        np.clip(speed / 4.0 + np.abs(wander(rng, yaw.size, 0.2, 3.0)), 0.0, 1.0),
    )


def flight(rng: RNG) -> Motion:
    """Fly a multirotor for 150 s: it leans to accelerate, and drag balances that in the end."""
    rate, _ = _legs(rng, 150.0)
    yaw = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(rate) * STEP_S
    roll, pitch = (smooth(wander(rng, yaw.size, math.radians(9.0), 4.0), 0.6) for _ in range(2))
    euler = np.stack([roll, pitch, yaw], axis=1)
    thrust = -matrices(euler)[:, :, 2] * (GRAVITY / (np.cos(roll) * np.cos(pitch)))[:, np.newaxis]
    push, (x, y, z) = thrust + np.array([0.0, 0.0, GRAVITY]), (0.0, 0.0, 0.0)
    velocity = np.empty_like(push)
    for k, (a, b, c) in enumerate(push.tolist()):
        x, y, z = x + (a - 0.5 * x) * STEP_S, y + (b - 0.5 * y) * STEP_S, z + (c - 0.5 * z) * STEP_S
        velocity[k] = x, y, z
    lean = np.hypot(roll, pitch) / math.radians(30.0)
    effort = np.clip(0.4 + lean + wander(rng, yaw.size, 0.15, 2.0), 0.1, 1.0)
    return Motion(euler, np.gradient(velocity, STEP_S, axis=0), velocity, effort)
