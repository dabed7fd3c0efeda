"""What gyro, accelerometer and receiver say of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from mavcompass.gap.trial.vehicles.draw import Imu, Receiver
from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S, Motion
from mavcompass.gap.trial.vehicles.rotations import Array, to_body
from mavcompass.gap.trial.vehicles.scene import Scene

_CUTOFF_HZ = 20.0
# White noise of velocity (m/s) and position (m), slow wander of velocity and position, its memory (s).
_RECEIVERS: dict[Receiver, tuple[float, float, float, float, float]] = {
    "gps": (0.05, 0.03, 0.05, 0.7, 60.0),
    "rtk": (0.03, 0.008, 0.02, 0.012, 30.0),
    "vision": (0.02, 0.005, 0.01, 0.01, 30.0),
}


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


def true_imu(motion: Motion) -> Felt:
    """Return what a perfect IMU gives."""
    force = to_body(motion.rotation, motion.acceleration_mps2 - GRAVITY_NED_MPS2)
    return Felt(motion.rate_radps, force)


def measured_imu(imu: Imu, scene: Scene, rng: np.random.Generator) -> Felt:
    """Add bias, scale error, noise, walk and vibration, through the autopilot's low pass of 20 Hz."""
    true = true_imu(scene.motion)
    shape = true.gyro_radps.shape
    walk = np.cumsum(rng.standard_normal(shape), axis=0) * imu.gyro_walk * np.sqrt(STEP_S)
    gyro = true.gyro_radps * (1.0 + imu.gyro_scale) + imu.gyro_bias + walk
    gyro = gyro + imu.gyro_noise * rng.standard_normal(shape)
    shaking = imu.acc_noise + imu.acc_vibration * np.minimum(2.0 * scene.loads.throttle, 1.0)
    acc = true.acc_mps2 + imu.acc_bias + shaking[:, None] * rng.standard_normal(shape)
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
