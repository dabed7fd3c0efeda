"""The equations of a motion's fit: what sections (S1) and turns should read, the prior, a first state."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.model import (
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HORIZONTAL,
    MOTOR,
    OFFSET,
    VERTICAL,
    by_tilt,
    gain_jacobian,
    gain_matrix,
)
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.positions import IronPrior
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

# After the 16 numbers of `model.NAMES`: the field's lag, then the sections' headings.
LAG, FIRST = 16, 17
_LAG_SIGMA_S = 0.03
_STARTS, _CLOSELY = 12, 11
# What is linear in the state once the headings are given: offset, gain, motors.
_LINEAR = np.r_[0:9, 13:16]


@dataclass(frozen=True, slots=True, eq=False)
class PriorRows:
    rows: FloatArray  # (Q, P), whitened
    wanted: FloatArray  # (Q,)

    def of(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.rows @ x - self.wanted)


def field_residual(sections: Sections, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residuals (K, 3) and the derivative of the prediction by the state, (K, 3, P)."""
    k = len(sections)
    psi = x[FIRST:]
    gain, h, z = gain_matrix(x[GAIN]), x[HORIZONTAL], x[VERTICAL]
    mapping = sections.mapping + x[LAG] * sections.by_lag
    cos, sin = np.cos(psi), np.sin(psi)
    level = np.stack([h * cos, -h * sin, np.full(k, z)], axis=1)
    body = np.einsum("kij,kj->ki", mapping, level)
    load = sections.load[:, np.newaxis]
    residual = sections.mean_mgauss - (x[OFFSET] + body @ gain + load * x[MOTOR])
    by = np.zeros((k, 3, x.size))
    by[:, :, OFFSET] = np.eye(3)
    by[:, :, GAIN] = gain_jacobian(body)
    seen = gain @ mapping
    by[:, :, HORIZONTAL] = seen[:, :, 0] * cos[:, np.newaxis] - seen[:, :, 1] * sin[:, np.newaxis]
    by[:, :, VERTICAL] = seen[:, :, 2]
    by[:, :, MOTOR] = load[:, :, np.newaxis] * np.eye(3)
    by[:, :, LAG] = np.einsum("kij,kj->ki", sections.by_lag, level) @ gain
    across = -h * (seen[:, :, 0] * sin[:, np.newaxis] + seen[:, :, 1] * cos[:, np.newaxis])
    by[np.arange(k), :, FIRST + np.arange(k)] = across
    return residual, by


def turn_residual(sections: Sections, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the whitened residuals of the turns (K - 1,) and their derivative by the state."""
    k = len(sections)
    turn = np.diff(x[FIRST:])
    step, sigma, lasted = np.diff(sections.turned_rad), sections.step_sigma_rad, np.diff(sections.middle_s)
    scale = 1.0 + x[GYRO_SCALE]
    rows = np.arange(k - 1)
    jacobian = np.zeros((k - 1, x.size))
    jacobian[rows, FIRST + rows + 1] = scale / sigma
    jacobian[rows, FIRST + rows] = -scale / sigma
    jacobian[:, GYRO_SCALE] = turn / sigma
    jacobian[:, GYRO_BIAS] = lasted / sigma
    return (scale * turn + x[GYRO_BIAS] * lasted - step) / sigma, jacobian


def section_variance(
    sections: Sections, x: FloatArray, model_mgauss: float, weighed: bool = True
) -> FloatArray:
    """Return the covariance of each section's mean, (K, 3, 3): noise, whole numbers, tilt, model error.

    `weighed`: what the sections of one visit share is multiplied, so that together they count once.
    """
    leaning = by_tilt(sections.mapping, x, x[FIRST:])
    tilt = leaning @ np.swapaxes(leaning, 1, 2)
    alike = (model_mgauss**2 + sections.hidden_mgauss**2)[:, :, np.newaxis] * np.eye(3)
    shared = tilt * sections.tilt_sigma_rad[:, np.newaxis, np.newaxis] ** 2 + alike
    white = (sections.noise_mgauss**2 / sections.samples)[:, np.newaxis, np.newaxis] * np.eye(3)
    return np.asarray(
        (sections.repeats if weighed else np.ones(len(sections)))[:, np.newaxis, np.newaxis] * shared + white
    )


def _prior_rows(
    sections: Sections,
    earth: EarthField | None,
    prior: IronPrior,
    motor_sigma: float,
    in_force: FieldCorrection | None,
    horizontal: float,
    vertical: float,
) -> PriorRows:
    """Write the prior as whitened rows."""
    size = FIRST + len(sections)
    held: list[tuple[int, float, float]] = [
        (3, 1.0, prior.gain_sigma),
        (4, 1.0, prior.gain_sigma),
        *((i, 0.0, prior.cross_sigma) for i in (6, 7, 8)),
        (GYRO_SCALE, 0.0, sections.scale_sigma),
        (GYRO_BIAS, 0.0, max(sections.bias_sigma_radps, 1e-9)),
        (LAG, 0.0, _LAG_SIGMA_S),
        *((13 + i, 0.0, motor_sigma) for i in range(3)),
    ]
    if earth is not None:
        north, _, down = earth.sigma_mgauss
        held.append((HORIZONTAL, horizontal, math.hypot(north, prior.site_sigma_mgauss)))
        held.append((VERTICAL, vertical, math.hypot(down, prior.site_sigma_mgauss)))
    else:
        held.append((HORIZONTAL, horizontal, 0.5 * horizontal))
        held.append((VERTICAL, vertical, max(0.5 * abs(vertical), 50.0)))
        offset = -in_force.offsets_mgauss[2] if in_force is not None else 0.0
        held.append((2, offset, prior.vertical_offset_sigma_mgauss))
    rows, wanted = np.zeros((len(held) + 1, size)), np.zeros(len(held) + 1)
    for row, (place, value, sigma) in enumerate(held):
        rows[row, place], wanted[row] = 1.0 / sigma, value / sigma
    rows[-1, 3:6] = np.array([-0.5, -0.5, 1.0]) / prior.vertical_gain_sigma
    return PriorRows(rows, wanted)


def first_state(
    sections: Sections,
    earth: EarthField | None,
    prior: IronPrior,
    motor_sigma: float,
    in_force: FieldCorrection | None,
) -> tuple[FloatArray, PriorRows]:
    """Find a first state: the first heading is tried all round, the rest is linear then.

    Half a turn away and all gains negative the field is the same, and only the prior tells: near the best and
    opposite to it the heading is tried closely, so that what it is off by weighs less than that.
    """
    if earth is not None:
        horizontal, vertical = earth.horizontal_mgauss, float(earth.ned_mgauss[2])
    else:
        field = (in_force or FieldCorrection()).apply(sections.mean_mgauss)
        swing = np.percentile(field[:, :2], 95, axis=0) - np.percentile(field[:, :2], 5, axis=0)
        horizontal, vertical = max(0.5 * float(swing.max()), 1.0), float(np.median(field[:, 2]))
    rules = _prior_rows(sections, earth, prior, motor_sigma, in_force, horizontal, vertical)
    x = np.zeros(FIRST + len(sections))
    x[GAIN], x[HORIZONTAL], x[VERTICAL] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), horizontal, vertical

    def tried(starts_rad: FloatArray) -> FloatArray:
        trials = []
        for start in starts_rad:
            x[FIRST:] = start + sections.turned_rad - sections.turned_rad[0]
            trials.append(_linear(sections, x, rules, 0.1 * horizontal))
        return min(trials, key=lambda trial: trial[1])[0]

    step = 2.0 * math.pi / _STARTS
    near = tried(np.arange(_STARTS) * step)[FIRST] + np.linspace(-0.5, 0.5, _CLOSELY) * step
    return tried(np.concatenate([near, near + math.pi])), rules


def _linear(sections: Sections, x: FloatArray, rules: PriorRows, noise: float) -> tuple[FloatArray, float]:
    """Solve for the linear part at the headings of `x`, robustly; returns the state and its cost."""
    x, weights, cost = x.copy(), np.ones(len(sections)), math.inf
    residual, by = field_residual(sections, x)
    by, held = by[:, :, _LINEAR] / noise, rules.rows[:, _LINEAR]
    residual = residual / noise
    for _ in range(3):
        weighed = (by * weights[:, np.newaxis, np.newaxis]).reshape(-1, _LINEAR.size)
        normal = weighed.T @ by.reshape(-1, _LINEAR.size) + held.T @ held
        step = np.linalg.solve(normal, weighed.T @ residual.ravel() - held.T @ rules.of(x))
        x[_LINEAR] += step
        residual = residual - by @ step
        size = np.linalg.norm(residual, axis=1)
        weights = 1.0 / np.maximum(1.0, size / max(2.0 * float(np.median(size)), 1e-6 / noise))
        cost = float((weights * size**2).sum()) + float((rules.of(x) ** 2).sum())
    return x, cost
