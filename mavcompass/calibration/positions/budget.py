"""Where the heading's uncertainty comes from: the covariance of each source, carried through the fit."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.model import GYRO_BIAS, GYRO_SCALE, HORIZONTAL, MOTOR, VERTICAL, heading_gradient
from mavcompass.calibration.positions.fit import Blend, PositionFit
from mavcompass.calibration.positions.problem import PositionProblem

# As the report names them.
# What no further position averages out.
ACCELEROMETER = "accelerometer"
SOURCES = (
    "noise",
    "step_angle",
    "tilt",
    ACCELEROMETER,
    "world_model",
    "quantisation",
    "disturbance",
    "prior",
)


def heading_budget(problem: PositionProblem, fit: PositionFit, blend: Blend) -> dict[str, float]:
    """Split the heading's rms sigma over the circle by source, radians; the squares add up to the whole."""
    k = len(problem.readings)
    circle = np.arange(36) * (2.0 * math.pi / 36)
    gradient = np.zeros((36, fit.state.size))
    gradient[:, :9] = heading_gradient(blend.state, circle)
    gains = gradient @ fit.covariance @ fit.jacobian.T  # heading by whitened residual, (36, R)
    field = gains[:, : 3 * k].reshape(36, k, 3)
    variance = dict.fromkeys(SOURCES, 0.0)
    for name, part in (
        ("noise", problem.noise),
        ("quantisation", problem.quantisation),
        ("tilt", problem.tilt),
    ):
        unit = problem.whiten @ part @ np.swapaxes(problem.whiten, 1, 2)
        variance[name] = float(np.einsum("nki,kij,nkj->n", field, unit, field).mean())
    variance[ACCELEROMETER] = float(((gradient @ blend.shared) ** 2).sum(axis=1).mean())
    rest = (gains[:, 3 * k :] ** 2).mean(axis=0)
    variance["step_angle"] = float(rest[: k - 1].sum())
    for place, share in zip(problem.rules.places, rest[k - 1 : -1], strict=True):
        variance[_source_of(place)] += float(share)
    variance["prior"] += float(rest[-1])
    # What the blends add (was a dwell disturbed? are there cross terms?) or save goes to the disturbance,
    # or lowers all alike.
    whole = float(np.einsum("ni,ij,nj->n", gradient, blend.covariance, gradient).mean())
    sum_of_parts = max(sum(variance.values()), 1e-30)
    if whole >= sum_of_parts:
        variance["disturbance"] += whole - sum_of_parts
        sum_of_parts = whole
    return {name: math.sqrt(value * whole / sum_of_parts) for name, value in variance.items()}


def _source_of(place: int) -> str:
    if place in (GYRO_SCALE, GYRO_BIAS):
        return "step_angle"
    if place in (HORIZONTAL, VERTICAL):
        return "world_model"
    if MOTOR.start <= place < MOTOR.stop:
        return "disturbance"
    return "prior"
