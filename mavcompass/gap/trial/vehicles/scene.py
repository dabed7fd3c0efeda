"""A vehicle in one motion: loads, the chain from the world's field to the compass's readings, other sensors.

    world field -> body axes -> hull -> soft iron -> matrix, iron, current (the vehicle as it is)
      -> fields added at the sensor -> the sensor's own gains and axes -> electronics -> readings

What happens at the sensor acts on all that it measures, the vehicle's iron included.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
import scipy

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import rotate_back
from mavcompass.gap.trial.vehicles.draw import Compass, Imu, Receiver, Vehicle
from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S, Motion, smooth

# Roll, pitch and yaw share of a quadrotor's motors: front right, rear left, front left, rear right.
_QUAD_X = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])
Values = dict[str, float]
_READ_EVERY_S = 0.1
_AVERAGED = 10
_SLOW_NOISE_S = 3.0
_CUTOFF_HZ = 20.0
# White noise of velocity (m/s) and position (m), slow wander of velocity and position, its memory (s).
_RECEIVERS: dict[Receiver, tuple[float, float, float, float, float]] = {
    "gps": (0.05, 0.03, 0.05, 0.7, 60.0),
    "rtk": (0.03, 0.008, 0.02, 0.012, 30.0),
    "vision": (0.02, 0.005, 0.01, 0.01, 30.0),
}


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
    force = rotate_back(motion.rotation, GRAVITY_NED_MPS2[None, :] - motion.acceleration_mps2)
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


class Stage(IntEnum):
    """Order the places of the chain where something can act."""

    WORLD = 0
    AMBIENT = 1
    OUTPUT = 2
    SENSOR = 3
    STREAM = 4
    READING = 5


@dataclass(frozen=True, eq=False)
class Scene:
    """Hold a vehicle in a motion at a site.

    Attributes:
        field_mgauss: the world's field there, (3,), NED.
        start_s: time since boot at the motion's time 0.
        row_s: times of the messages, (R,), from the motion's time 0.
        reading_s: times of the compass readings, (K,); held: the reading that each message carries, (R,).
    """

    vehicle: Vehicle
    motion: Motion
    loads: Loads
    field_mgauss: Array
    start_s: float
    row_s: Array
    reading_s: Array
    held: np.ndarray

    @cached_property
    def plain_mgauss(self) -> Array:
        """Return what the sensor converts without any effect, (N, 3)."""
        return stream(self)

    @property
    def compass(self) -> Compass:
        """Return the compass under test."""
        return self.vehicle.compass


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """Hold an effect with its values: `act(values (M, 3), parameters, scene, rng)` at its stage.

    The generator that `act` gets starts anew from `seed` each time: an effect is the same whenever asked.
    """

    id: str
    stage: Stage
    act: Callable[[Array, Values, Scene, np.random.Generator], Array]
    parameters: Values
    seed: int = field(default=0)


def scene_of(
    vehicle: Vehicle, motion: Motion, loads: Loads, field_mgauss: Array, rng: np.random.Generator
) -> Scene:
    """Put a vehicle into a motion: when its messages are sent and its compass is read."""
    count = int(motion.time_s[-1] * vehicle.rate_hz)
    rows = (np.arange(count) + 0.5) / vehicle.rate_hz + np.abs(rng.normal(0.0, 8e-4, count))
    rows = np.minimum(rows, motion.time_s[-1])
    readings, held = rows, np.arange(count)
    if vehicle.compass.averaged:
        readings = np.arange(rng.uniform(0.0, _READ_EVERY_S), motion.time_s[-1], _READ_EVERY_S)
        held = np.maximum(np.searchsorted(readings, rows, side="right") - 1, 0)
    start = float(np.exp(rng.uniform(np.log(50.0), np.log(900.0))))
    return Scene(vehicle, motion, loads, field_mgauss, start, rows, readings, held)


def ambient(scene: Scene, effects: Sequence[Effect] = ()) -> Array:
    """Return the world's field at the vehicle in body axes at 100 Hz, (N, 3), milligauss."""
    world = np.tile(scene.field_mgauss, (scene.motion.time_s.size, 1))
    return rotate_back(scene.motion.rotation, _acted(world, Stage.WORLD, scene, effects))


def stream(scene: Scene, effects: Sequence[Effect] = ()) -> Array:
    """Return what the sensor converts at 100 Hz, without noise, (N, 3), milligauss."""
    compass = scene.compass
    around = _acted(ambient(scene, effects), Stage.AMBIENT, scene, effects)
    raw = around @ compass.matrix.T + compass.iron_mgauss
    raw = raw + scene.loads.current_a[:, None] * compass.current_field
    for stage in (Stage.OUTPUT, Stage.SENSOR, Stage.STREAM):
        raw = _acted(raw, stage, scene, effects)
    return raw


def readings(
    scene: Scene, raw: Array, effects: Sequence[Effect] = (), noise: np.random.Generator | None = None
) -> Array:
    """Read what `stream` gave (N, 3) at `scene.reading_s`: (K, 3) milligauss, with noise from a generator."""
    latest = np.minimum((scene.reading_s / STEP_S).astype(np.int64), len(raw) - 1)
    if scene.compass.averaged:
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(raw, axis=0)])
        first = np.maximum(latest + 1 - _AVERAGED, 0)
        read = (total[latest + 1] - total[first]) / (latest + 1 - first)[:, None]
    else:
        read = raw[latest]
    if noise is not None:
        read = read + _noise(scene, noise)
    return _acted(read, Stage.READING, scene, effects)


def _noise(scene: Scene, rng: np.random.Generator) -> Array:
    shape = (scene.reading_s.size, 3)
    keep = np.exp(-np.median(np.diff(scene.reading_s)) / _SLOW_NOISE_S)
    slow = scipy.signal.lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(shape), axis=0)
    white = rng.standard_normal(shape) * scene.compass.noise_mgauss
    return np.asarray(white + scene.compass.slow_noise_mgauss * slow)


def _acted(values: Array, stage: Stage, scene: Scene, effects: Sequence[Effect]) -> Array:
    for effect in effects:
        if effect.stage == stage:
            values = effect.act(values, effect.parameters, scene, np.random.default_rng(effect.seed))
    return values


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Hold what the IMU gives at 100 Hz: angular rate and specific force, body FRD, (N, 3)."""

    gyro_radps: Array
    acc_mps2: Array


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """Hold a receiver's fixes: times (F,), velocity and position NED (F, 3), as late as they come."""

    time_s: Array
    velocity_mps: Array
    position_m: Array


def measured_imu(imu: Imu, scene: Scene, rng: np.random.Generator) -> Felt:
    """Add bias, scale error, noise, walk and vibration, through the autopilot's low pass of 20 Hz."""
    motion = scene.motion
    force = rotate_back(motion.rotation, motion.acceleration_mps2 - GRAVITY_NED_MPS2)
    shape = force.shape
    walk = np.cumsum(rng.standard_normal(shape), axis=0) * imu.gyro_walk * np.sqrt(STEP_S)
    gyro = motion.rate_radps * (1.0 + imu.gyro_scale) + imu.gyro_bias + walk
    gyro = gyro + imu.gyro_noise * rng.standard_normal(shape)
    shaking = imu.acc_noise + imu.acc_vibration * np.minimum(2.0 * scene.loads.throttle, 1.0)
    acc = force + imu.acc_bias + shaking[:, None] * rng.standard_normal(shape)
    return Felt(_low_passed(gyro), _low_passed(acc))


def _low_passed(values: Array) -> Array:
    b, a = scipy.signal.butter(2, _CUTOFF_HZ * 2.0 * STEP_S)
    start = values[:1]
    # From rest at the first value: no transient.
    return np.asarray(scipy.signal.lfilter(b, a, values - start, axis=0) + start)


def fixes_of(scene: Scene, receiver: Receiver, rate_hz: float, rng: np.random.Generator) -> Fixes:
    """Let a receiver tell velocity and position, with its noise, its wander and its delay."""
    motion = scene.motion
    white_v, white_p, slow_v, slow_p, memory = _RECEIVERS[receiver]
    late = rng.uniform(0.02, 0.12) if receiver != "vision" else rng.uniform(0.01, 0.05)
    time = np.arange(rng.uniform(0.0, 1.0 / rate_hz), motion.time_s[-1], 1.0 / rate_hz)
    index = np.maximum(((time - late) / STEP_S).astype(np.int64), 0)
    shape = (time.size, 3)
    worse_down = np.array([1.0, 1.0, 1.6])

    def told(truth: Array, white: float, slow: float) -> Array:
        keep = np.exp(-1.0 / (rate_hz * memory))
        start = rng.standard_normal((1, 3))
        driven = np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
        wander, _ = scipy.signal.lfilter([1.0], [1.0, -keep], driven, axis=0, zi=keep * start)
        return np.asarray(truth[index] + (white * rng.standard_normal(shape) + slow * wander) * worse_down)

    return Fixes(time, told(motion.velocity_mps, white_v, slow_v), told(motion.position_m, white_p, slow_p))
