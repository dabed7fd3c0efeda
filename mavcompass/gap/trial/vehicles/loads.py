"""What a motion asks of the motors and the battery, and how warm the sensor gets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S, Motion, smooth
from mavcompass.gap.trial.vehicles.rotations import Array, to_body

# Roll, pitch and yaw share of a quadrotor's motors: front right, rear left, front left, rear right.
_QUAD_X = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """Hold throttle (N,) 0..1, motor outputs (N, k) 0..1, battery current (N,) A, temperature (N,) degC."""

    throttle: Array
    motors: Array
    current_a: Array
    temperature_degc: Array
    neutral: float = 0.0

    @property
    def efforts(self) -> Array:
        """Return how hard each motor works, 0 to 1, (N, k); one that turns both ways rests in the middle."""
        return np.abs(self.motors - self.neutral) / (1.0 - self.neutral)


def loads_of(kind: str, motion: Motion, ambient_degc: float, rng: np.random.Generator) -> Loads:
    """Work out the loads of a kind of vehicle in a motion."""
    idle = rng.uniform(0.25, 0.6)
    neutral = 0.0 if kind == "copter" else 0.5
    if motion.name == "hand":
        still = np.zeros_like(motion.time_s)
        count = 2 if kind == "rover" else 4
        throttle, outputs = still, np.full((still.size, count), neutral)
        drawn = np.full_like(still, idle)
    elif kind == "copter":
        throttle, outputs, drawn = _lifting(motion, rng)
    else:
        throttle, outputs, drawn = _driving(kind, motion, rng)
    gusts = 1.0 + 0.06 * _drift(motion.time_s, 1.5, rng)
    current = smooth(np.asarray(idle + drawn * gusts), 0.15)
    return Loads(throttle, outputs, current, _warmth(motion, drawn, ambient_degc, rng), neutral)


def _driving(kind: str, motion: Motion, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    forward, down = motion.rotation[:, :, 0], motion.rotation[:, :, 2]
    speed = np.einsum("ni,ni->n", motion.velocity_mps, forward)
    pull = np.einsum("ni,ni->n", motion.acceleration_mps2, forward)
    uphill = -GRAVITY_NED_MPS2[2] * forward[:, 2]
    turning = np.einsum("ni,ni->n", np.cross(down, forward), np.gradient(forward, STEP_S, axis=0))
    top = max(float(speed.max()), 1.0) * rng.uniform(1.2, 2.2)
    resistance = (speed / top) ** 2 * np.sign(speed) if kind == "boat" else speed / top
    effort = resistance + 0.06 * (pull + uphill) + 0.02 * _drift(motion.time_s, 0.6, rng)
    most = rng.uniform(6.0, 25.0)
    if kind == "ackermann-rover":
        wheels = np.clip(effort, -1.0, 1.0)[:, None]
    else:
        twist = rng.uniform(0.15, 0.35) * turning
        wheels = np.clip(np.stack([effort + twist, effort - twist], axis=1), -1.0, 1.0)
    drawn = most * (np.abs(wheels) ** 1.5).mean(axis=1)
    return np.clip(np.abs(effort), 0.0, 1.0), 0.5 + 0.5 * wheels, drawn


def _lifting(motion: Motion, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    force = to_body(motion.rotation, GRAVITY_NED_MPS2[None, :] - motion.acceleration_mps2)
    hover = rng.uniform(0.28, 0.5)
    lift = np.clip(force[:, 2] / GRAVITY_NED_MPS2[2], 0.2, 2.0)
    throttle = np.clip(hover * lift + 0.008 * _drift(motion.time_s, 0.4, rng), 0.0, 1.0)
    angular = np.asarray(np.gradient(motion.rate_radps, STEP_S, axis=0))
    spin = np.stack([smooth(column, 0.05) for column in angular.T], axis=1)
    trim = 0.015 * rng.standard_normal(3)
    mixed = (np.array([0.012, 0.012, 0.05]) * spin + trim) @ _QUAD_X.T
    flutter = np.stack([_drift(motion.time_s, 0.3, rng) for _ in range(4)], axis=1)
    motors = np.clip(throttle[:, None] + mixed + 0.012 * flutter, 0.05, 1.0)
    per_motor = rng.uniform(12.0, 30.0)
    return throttle, motors, per_motor * (motors**1.5).sum(axis=1)


def _warmth(motion: Motion, drawn: Array, ambient_degc: float, rng: np.random.Generator) -> Array:
    """Let the electronics warm up by their own loss and the motors', and cool in the wind."""
    time = motion.time_s
    loss = rng.uniform(3.0, 10.0) + rng.uniform(0.0, 8.0) * drawn / max(float(drawn.max()), 1.0)
    loss = loss * (1.0 - 0.05 * np.minimum(np.linalg.norm(motion.velocity_mps, axis=1), 6.0))
    constant = rng.uniform(40.0, 200.0)
    # Exact first-order response to a loss that is held over each second.
    each = round(1.0 / STEP_S)
    level = rng.choice([0.0, 0.0, 1.6]) * float(loss.mean())
    levels = []
    for value in loss[::each]:
        levels.append(level)
        level += (value - level) * (1.0 - np.exp(-1.0 / constant))
    rise = np.interp(time, time[::each], levels)
    return np.asarray(ambient_degc + rise + 0.15 * _drift(time, 8.0, rng))


def _drift(time: Array, memory_s: float, rng: np.random.Generator) -> Array:
    """Return unit-variance noise (N,) that forgets within a time."""
    coarse = max(1, round(0.3 * memory_s / STEP_S))
    knots = rng.standard_normal(time.size // coarse + 4)
    knots = np.convolve(knots, [0.5, 0.5**0.5, 0.5], mode="same")
    return np.interp(time, np.arange(knots.size) * coarse * STEP_S, knots)
