"""A motion as the problem of a rigid compass: its covariances, its prior, a first state."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.model import GAIN, HEADINGS, HORIZONTAL, VERTICAL, by_tilt
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.rigid import IronPrior, PriorRows, Readings, prior_rows
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

_STARTS, _CLOSELY = 12, 11
# What is linear in the state once the headings are given: offset, gain, motors.
_LINEAR = np.r_[0:9, 13:16]


def section_variance(
    sections: Sections, x: FloatArray, model_mgauss: float, weighed: bool = True
) -> FloatArray:
    """Return the covariance of each section's mean, (K, 3, 3): noise, whole numbers, tilt, model error.

    `weighed`: what the sections of one visit share is multiplied, so that together they count once.
    """
    leaning = by_tilt(sections.mapping, x, x[HEADINGS:])
    tilt = leaning @ np.swapaxes(leaning, 1, 2)
    alike = (model_mgauss**2 + sections.hidden_mgauss**2)[:, :, np.newaxis] * np.eye(3)
    shared = tilt * sections.tilt_sigma_rad[:, np.newaxis, np.newaxis] ** 2 + alike
    white = (sections.noise_mgauss**2 / sections.samples)[:, np.newaxis, np.newaxis] * np.eye(3)
    return np.asarray(
        (sections.repeats if weighed else np.ones(len(sections)))[:, np.newaxis, np.newaxis] * shared + white
    )


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
    rules = prior_rows(
        len(sections),
        prior,
        earth,
        in_force,
        vertical,
        (sections.scale_sigma, sections.bias_sigma_radps),
        motor_sigma,
    )
    readings = sections.readings
    x = np.zeros(HEADINGS + len(sections))
    x[GAIN], x[HORIZONTAL], x[VERTICAL] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), horizontal, vertical

    def tried(starts_rad: FloatArray) -> FloatArray:
        trials = []
        for start in starts_rad:
            x[HEADINGS:] = start + sections.turned_rad - sections.turned_rad[0]
            trials.append(_linear(readings, x, rules, 0.1 * horizontal))
        return min(trials, key=lambda trial: trial[1])[0]

    step = 2.0 * math.pi / _STARTS
    near = (
        tried(step * np.arange(_STARTS, dtype=np.float64))[HEADINGS] + np.linspace(-0.5, 0.5, _CLOSELY) * step
    )
    return tried(np.concatenate([near, near + math.pi])), rules


def _linear(readings: Readings, x: FloatArray, rules: PriorRows, noise: float) -> tuple[FloatArray, float]:
    """Solve for the linear part at the headings of `x`, robustly; returns the state and its cost."""
    x, weights, cost = x.copy(), np.ones(len(readings)), math.inf
    residual, by = readings.field(x)
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
