"""The attitude is not what the reference says."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray, rotate, rotate_back, rotvec_to_matrix
from mavcompass.simulation.effects.effect import (
    GROUPS,
    Effect,
    Memory,
    Misfit,
    Parameter,
    Rng,
    Signals,
    Stage,
    axes,
)


def _reference_error(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    error = rotvec_to_matrix(theta)
    s = signals.stimulus
    return signals.turned(s.rotation @ error, s.rate_radps @ error)


def _platform_tilt(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    tilt = rotvec_to_matrix(np.array([theta[0], theta[1], 0.0]))
    s = signals.stimulus
    return signals.turned(tilt @ s.rotation, s.rate_radps)


def _yaw_step_error(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    s = signals.stimulus
    yaw = np.arctan2(s.rotation[:, 1, 0], s.rotation[:, 0, 0])
    first, last = memory.get("yaw", (yaw[0], yaw[0]))
    unwrapped = np.unwrap(np.concatenate([[last], yaw]))[1:]
    memory["yaw"] = (first, unwrapped[-1])
    extra = theta[0] * (unwrapped - first)
    c, d = np.cos(extra), np.sin(extra)
    rotation = s.rotation.copy()
    rotation[:, 0] = c[:, None] * s.rotation[:, 0] - d[:, None] * s.rotation[:, 1]
    rotation[:, 1] = d[:, None] * s.rotation[:, 0] + c[:, None] * s.rotation[:, 1]
    return signals.turned(rotation, s.rate_radps + theta[0] * _yaw_rate_vector(s.rotation, s.rate_radps))


def _yaw_starts(misfit: Misfit) -> list[FloatArray]:
    """Read the growing angle between measured and predicted level fields against the turned angle."""
    rows = np.flatnonzero(misfit.rows)
    rotation = misfit.signals.stimulus.rotation[rows]
    predicted = misfit.signals.reading.mag_mgauss[rows]
    a = rotate(rotation, predicted + misfit.residual.mag_mgauss[rows])
    b = rotate(rotation, predicted)
    off = np.unwrap(np.arctan2(b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0], b[:, 0] * a[:, 0] + b[:, 1] * a[:, 1]))
    turned = np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    turned = turned - turned.mean()
    power = float(turned @ turned)
    # The level field turns the other way than the reference that is believed.
    slope = -float(turned @ off) / power if power > 0.0 else 0.0
    return [np.zeros(1), np.array([np.clip(slope, -0.3, 0.3)])]


def _yaw_rate_vector(rotation: FloatArray, rate_radps: FloatArray) -> FloatArray:
    """Return the body rate (N, 3) of the yaw motion alone: psi' about the world's down axis."""
    # psi' = (q sin(roll) + r cos(roll)) / cos(pitch), with the angles read off the last row of R.
    cos_pitch_2 = np.maximum(1.0 - rotation[:, 2, 0] ** 2, 1e-6)
    rate = (rate_radps[:, 1] * rotation[:, 2, 1] + rate_radps[:, 2] * rotation[:, 2, 2]) / cos_pitch_2
    down = np.zeros_like(rate_radps)
    down[:, 2] = rate
    return rotate_back(rotation, down)


EFFECTS = (
    Effect(
        id="attitude_reference_error",
        title="the attitude reference is turned against the sensors",
        stage=Stage.ATTITUDE,
        parameters=axes(-0.35, 0.35, (0.02, -0.015, 0.03), 0.02, "rad"),
        forward=_reference_error,
        enough=("acc", "gyro"),
        groups=GROUPS,
        needs=frozenset({"reference"}),
        aliases=("misalignment", "declination"),
        separated_by="an independent reference: it shows in all three sensors",
        source="R exp[w], 0.2 to 5 degrees",
    ),
    Effect(
        id="platform_tilt",
        title="the ground or the turntable is not level",
        stage=Stage.ATTITUDE,
        parameters=axes(-0.2, 0.2, (0.02, -0.03), 0.01, "rad", ("about_north", "about_east")),
        forward=_platform_tilt,
        enough=("acc",),
        groups=GROUPS,
        needs=frozenset({"reference"}),
        aliases=("inclination", "accel_bias"),
        separated_by="turn the vehicle by 180 degrees: it stays in the world, a bias goes with the body",
        source="exp[tilt] R, 0.2 to 3 degrees",
    ),
    Effect(
        id="yaw_step_error",
        title="turns are longer or shorter than commanded",
        stage=Stage.ATTITUDE,
        parameters=(Parameter("fraction", "1", -0.3, 0.3, 0.03, 0.005),),
        forward=_yaw_step_error,
        starts=_yaw_starts,
        enough=("mag",),
        groups=GROUPS,
        needs=frozenset({"turning", "reference"}),
        aliases=("gyro_scale", "declination"),
        separated_by="several whole turns",
        source="yaw - yaw_0 grows by (1 + e), 0.5 to 5 degrees per step",
    ),
)
