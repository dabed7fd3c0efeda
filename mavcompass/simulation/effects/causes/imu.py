"""Accelerometer and gyro: biases, gains, the lever arm, vibration."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import Effect, Memory, Rng, Signals, Stage, axes, on_acc, on_gyro
from mavcompass.simulation.effects.sampling import or_zero

_REFERENCE = frozenset({"reference"})


def _lever_arm(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    rate, time = signals.stimulus.rate_radps, signals.stimulus.time_s
    if "last" not in memory and len(time) > 2:
        angular = np.gradient(rate, time, axis=0)
    else:
        last_time, last_rate = memory.get("last", (time[0], rate[0]))
        step = np.diff(time, prepend=last_time)[:, None]
        change = np.diff(rate, axis=0, prepend=last_rate[None])
        angular = np.where(step > 0.0, change / np.where(step > 0.0, step, 1.0), 0.0)
    memory["last"] = (time[-1], rate[-1])
    arm = np.broadcast_to(theta, rate.shape)
    return signals.with_acc(
        signals.reading.acc_mps2 + np.cross(angular, arm) + np.cross(rate, np.cross(rate, arm))
    )


def _vibration(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    load = or_zero(signals.stimulus.throttle) ** 2
    return signals.with_acc(signals.reading.acc_mps2 + load[:, None] * theta)


EFFECTS = (
    Effect(
        id="accel_bias",
        detector="accelerometer offset",
        daily=0.25,
        title="an offset of the accelerometer",
        stage=Stage.IMU,
        parameters=axes(-5.0, 5.0, (0.15, -0.1, 0.2), 0.05, "m/s^2"),
        forward=on_acc(lambda force, theta: force + theta),
        groups=("acc",),
        needs=_REFERENCE,
        aliases=("accel_scale", "platform_tilt", "linear_acceleration"),
        separated_by="rest on all six faces",
        source="0.02 to 0.3 m/s^2",
        sitl=lambda v: {f"SIM_ACC1_BIAS_{a.upper()}": v[a] for a in "xyz"},
    ),
    Effect(
        id="accel_scale",
        title="a gain error of the accelerometer",
        stage=Stage.IMU,
        parameters=axes(-0.2, 0.2, (0.012, -0.01, 0.015), 0.01, "1"),
        forward=on_acc(lambda force, theta: force * (1.0 + theta)),
        groups=("acc",),
        needs=_REFERENCE,
        aliases=("accel_bias",),
        separated_by="rest on all six faces: level, it is the bias exactly",
        source="0.1 to 2 %",
        # The simulator divides by its factor, so that the value equals the calibration that cures it.
        sitl=lambda v: {f"SIM_ACC1_SCAL_{a.upper()}": 1.0 / (1.0 + v[a]) for a in "xyz"},
    ),
    Effect(
        id="linear_acceleration",
        title="the accelerometer sits away from the centre of turning",
        stage=Stage.IMU,
        parameters=axes(-3.0, 3.0, (0.3, 0.1, -0.05), 0.1, "m"),
        forward=_lever_arm,
        groups=("acc",),
        needs=_REFERENCE | {"turning"},
        aliases=("accel_bias",),
        separated_by="turn both ways and at several rates",
        source="a + w' x r + w x (w x r), arms of 0.05 to 1 m",
    ),
    Effect(
        id="vibration_rectification",
        title="an accelerometer offset that grows with vibration",
        stage=Stage.IMU,
        parameters=axes(-20.0, 20.0, (0.2, 0.1, -0.4), 0.1, "m/s^2 at full throttle"),
        forward=_vibration,
        groups=("acc",),
        needs=_REFERENCE | {"throttle"},
        aliases=("accel_bias",),
        separated_by="hover beside rest",
        source="c throttle^2, 0.02 to 0.5 m/s^2",
    ),
    Effect(
        id="gyro_bias",
        detector="gyro offset",
        daily=0.012,
        title="an offset of the gyro",
        stage=Stage.IMU,
        parameters=axes(-0.5, 0.5, (0.005, -0.004, 0.006), 0.003, "rad/s"),
        forward=on_gyro(lambda rate, theta: rate + theta),
        groups=("gyro",),
        needs=_REFERENCE,
        aliases=("yaw_step_error",),
        separated_by="rest",
        source="0.05 to 1 degree per second",
        sitl=lambda v: {f"SIM_GYR1_BIAS_{a.upper()}": v[a] for a in "xyz"},
    ),
    Effect(
        id="gyro_scale",
        detector="gyro gain",
        daily=0.04,
        title="a gain error of the gyro",
        stage=Stage.IMU,
        parameters=axes(-0.3, 0.3, (0.01, -0.008, 0.012), 0.01, "1"),
        forward=on_gyro(lambda rate, theta: rate * (1.0 + theta)),
        groups=("gyro",),
        needs=_REFERENCE | {"turning"},
        aliases=("yaw_step_error",),
        separated_by="the compass and several whole turns",
        source="0.1 to 3 %",
        sitl=lambda v: {f"SIM_GYR1_SCALE_{a.upper()}": 100.0 * v[a] for a in "xyz"},
    ),
)
