"""Faults of the sensor that the catalogue names: its axes, its gains, its electronics, its timing."""

from __future__ import annotations

import numpy as np
import scipy

from mavcompass.gap.trial.vehicles.effects.kind import (
    AXES,
    Grow,
    Kind,
    Rng,
    above,
    along,
    of,
    only,
    reference,
)
from mavcompass.gap.trial.vehicles.motion import STEP_S
from mavcompass.gap.trial.vehicles.rotations import Array, from_angles, from_vector
from mavcompass.gap.trial.vehicles.scene import Scene, Stage, Values

_CROSSED = ("xy", "xz", "yx", "yz", "zx", "zy")
_BELOW = ("yx", "zx", "zy")
_GAUSS = 1000.0
# MAV_SENSOR_ORIENTATION: roll, pitch, yaw of the sensor in the body, degrees.
_MOUNTINGS = {
    2: (0, 0, 90),
    4: (0, 0, 180),
    6: (0, 0, 270),
    1: (0, 0, 45),
    7: (0, 0, 315),
    8: (180, 0, 0),
    10: (180, 0, 90),
    12: (0, 180, 0),
    14: (180, 0, 270),
    16: (90, 0, 0),
    20: (270, 0, 0),
    24: (0, 90, 0),
    25: (0, 270, 0),
}


def _act_non_orthogonality(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    x, y, z = values.T
    return np.stack([x, y + p["yx"] * x, z + p["zx"] * x + p["zy"] * y], axis=1)


def _draw_orientation(rng: Rng, scene: Scene) -> Grow:
    number = float(rng.choice(list(_MOUNTINGS)))
    return lambda size: {"orientation": number}


def _act_orientation(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    roll, pitch, yaw = (np.array([np.radians(a)]) for a in _MOUNTINGS[round(p["orientation"])])
    # The sensor's axes in the body are the columns; each measures the field along itself.
    return values @ from_angles(roll, pitch, yaw)[0]


def _draw_temperature_sensitivity(rng: Rng, scene: Scene) -> Grow:
    shares, still = -rng.uniform(0.7, 1.3, 3), reference(rng, scene)
    return lambda size: dict(zip(AXES, (size * shares).tolist(), strict=True)) | {"reference_degc": still}


def _draw_clipping(rng: Rng, scene: Scene) -> Grow:
    top = float(np.abs(scene.plain_mgauss).max())
    return lambda size: {"limit_mgauss": top * (1.0 - size)}


def _act_lag(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.motion.time_s
    return np.stack([np.interp(time - p["lag_s"], time, column) for column in values.T], axis=1)


def _act_low_pass(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    keep = np.exp(-STEP_S / p["time_constant_s"])
    out, _ = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])
    return np.asarray(out)


def _act_cross_axis(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    gain = np.ones_like(values)
    for name in _CROSSED:
        gain[:, AXES.index(name[0])] += p[name] * values[:, AXES.index(name[1])] / _GAUSS
    return values * gain


def _act_set_reset(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    return values + np.where(np.arange(len(values)) % 2 == 0, 1.0, -1.0)[:, None] * of(p)


def _act_stale(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    fresh = rng.random(len(values)) >= p["fraction"]
    fresh[0] = True
    return values[np.maximum.accumulate(np.where(fresh, np.arange(len(values)), 0))]


ELECTRONICS = (
    Kind("axis_scale", Stage.SENSOR, along(), lambda v, p, s, r: v * (1.0 + of(p)), 0.03, 0.3),
    Kind("non_orthogonality", Stage.SENSOR, along(_BELOW), _act_non_orthogonality, 0.03, 0.15),
    Kind("misalignment", Stage.SENSOR, along(), lambda v, p, s, r: v @ from_vector(of(p)).T, 0.03, 0.3),
    Kind("orientation", Stage.SENSOR, _draw_orientation, _act_orientation, 1.0, 1.0, sized=False),
    Kind(
        "temperature_sensitivity",
        Stage.SENSOR,
        _draw_temperature_sensitivity,
        lambda v, p, s, r: v * (1.0 + above(p, s) * of(p)),
        0.003,
        0.012,
        frozenset({"warming"}),
    ),
    Kind(
        "clipping",
        Stage.READING,
        _draw_clipping,
        lambda v, p, s, r: np.clip(v, -p["limit_mgauss"], p["limit_mgauss"]),
        0.1,
        0.5,
    ),
    Kind("transport_lag", Stage.STREAM, only("lag_s"), _act_lag, 0.05, 0.3),
    Kind("low_pass", Stage.STREAM, only("time_constant_s"), _act_low_pass, 0.05, 0.35),
    Kind("cross_axis", Stage.SENSOR, along(_CROSSED), _act_cross_axis, 0.03, 0.15),
    Kind("set_reset_offset", Stage.READING, along(), _act_set_reset, 10.0, 100.0, frozenset({"each_row"})),
    Kind(
        "noise_excess",
        Stage.READING,
        only("sigma_mgauss"),
        lambda v, p, s, r: v + p["sigma_mgauss"] * r.standard_normal(v.shape),
        5.0,
        60.0,
    ),
    Kind("stale_samples", Stage.READING, only("fraction"), _act_stale, 0.3, 0.9),
    Kind(
        "quantisation",
        Stage.READING,
        only("step_mgauss"),
        lambda v, p, s, r: p["step_mgauss"] * np.round(v / p["step_mgauss"]),
        10.0,
        60.0,
        frozenset({"each_row"}),
    ),
)
