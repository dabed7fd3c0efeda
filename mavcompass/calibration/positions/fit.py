"""The four-position fit itself: Gauss-Newton, and how far cross terms are believed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.model import (
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADINGS,
    HORIZONTAL,
    MOTOR,
    OFFSET,
    VERTICAL,
    gain_jacobian,
    gain_matrix,
)
from mavcompass.calibration.positions.problem import IronPrior, PositionProblem
from mavcompass.frames import FloatArray

_ROBUST_FROM = 6
_MANY_SIGMAS_3D = 11.34  # chi-square of three, 99 %
_ITERATIONS = 40
# Before the data: most compasses away from steel have no cross terms that matter.
CROSS_TERMS_BEFORE = 0.25

# Whitened residuals (R,), their Jacobian (R, P), field residuals (K, 3).
Evaluation = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class PositionFit:
    state: FloatArray
    covariance: FloatArray
    residual: FloatArray  # (K, 3), mG
    jacobian: FloatArray  # whitened, rows: 3K field, K-1 steps, prior
    weights: FloatArray  # (K,)
    cost: float  # the squared whitened residuals, prior included
    chi_square: float
    freedom: int


def _evaluate(problem: PositionProblem, x: FloatArray, weights: FloatArray) -> Evaluation:
    """Return the whitened residuals (R,), their Jacobian (R, P) and the field residuals (K, 3)."""
    k = len(problem.mean)
    psi = x[HEADINGS:]
    c, s = problem.coherence * np.cos(psi), problem.coherence * np.sin(psi)
    h, gain = x[HORIZONTAL], gain_matrix(x[GAIN])
    mapping = gain @ problem.level_to_body
    level = np.stack([h * c, -h * s, np.full(k, x[VERTICAL])], axis=1)
    body = np.einsum("kij,kj->ki", problem.level_to_body, level)
    field = problem.mean - (x[OFFSET] + body @ gain + problem.current[:, np.newaxis] * x[MOTOR])
    by = np.zeros((k, 3, x.size))
    by[:, :, OFFSET] = np.eye(3)
    by[:, :, GAIN] = gain_jacobian(body)
    by[:, :, HORIZONTAL] = mapping[:, :, 0] * c[:, np.newaxis] - mapping[:, :, 1] * s[:, np.newaxis]
    by[:, :, VERTICAL] = mapping[:, :, 2]
    by[:, :, MOTOR] = problem.current[:, np.newaxis, np.newaxis] * np.eye(3)
    across = -h * (mapping[:, :, 0] * s[:, np.newaxis] + mapping[:, :, 1] * c[:, np.newaxis])
    by[np.arange(k), :, HEADINGS + np.arange(k)] = across
    root = np.sqrt(weights)[:, np.newaxis]
    field_rows = np.einsum("kij,kj->ki", problem.whiten, field) * root
    field_jacobian = -(problem.whiten @ by) * root[:, :, np.newaxis]
    turn = np.diff(psi)
    scale, bias = 1.0 + x[GYRO_SCALE], x[GYRO_BIAS]
    steps = (problem.steps - turn * scale - bias * problem.step_duration) / problem.step_sigma
    step_jacobian = np.zeros((k - 1, x.size))
    rows = np.arange(k - 1)
    step_jacobian[rows, HEADINGS + rows + 1] = -scale / problem.step_sigma
    step_jacobian[rows, HEADINGS + rows] = scale / problem.step_sigma
    step_jacobian[:, GYRO_SCALE] = -turn / problem.step_sigma
    step_jacobian[:, GYRO_BIAS] = -problem.step_duration / problem.step_sigma
    held = np.flatnonzero(np.isfinite(problem.sigma))
    prior_jacobian = np.zeros((held.size + 1, x.size))
    prior_jacobian[np.arange(held.size), held] = 1.0 / problem.sigma[held]
    prior = (x[held] - problem.centre[held]) / problem.sigma[held]
    xx, yy, zz = x[GAIN][:3]
    prior_jacobian[-1, 3:6] = np.array([-0.5, -0.5, 1.0]) / problem.vertical_gain_sigma
    vertical = (zz - 0.5 * (xx + yy)) / problem.vertical_gain_sigma
    residual = np.concatenate([field_rows.ravel(), steps, prior, [vertical]])
    jacobian = np.concatenate([field_jacobian.reshape(3 * k, -1), step_jacobian, prior_jacobian])
    return residual, jacobian, field


def fit_positions(problem: PositionProblem, near: PositionFit | None = None) -> PositionFit:
    """Minimise by Gauss-Newton with step halving; dwells far out weigh less where there are many.

    The fit of a problem that is nearly the same may be given to begin with.
    """
    x, weights = (problem.start, np.ones(len(problem.mean))) if near is None else (near.state, near.weights)
    here = _evaluate(problem, x, weights)
    for _ in range(_ITERATIONS):
        x, here, settled = _step(problem, x, weights, here)
        if len(problem.mean) >= _ROBUST_FROM:
            fresh = _weights(problem, here[2])
            if float(np.abs(fresh - weights).max()) > 1e-3:
                weights, settled = fresh, False
                here = _evaluate(problem, x, weights)
        if settled:
            break
    return _summary(x, weights, here)


def _step(
    problem: PositionProblem, x: FloatArray, weights: FloatArray, here: Evaluation
) -> tuple[FloatArray, Evaluation, bool]:
    """Take one Gauss-Newton step, halved until the cost does not rise; says whether it was negligible."""
    residual, jacobian, _ = here
    scale = 1.0 / np.linalg.norm(jacobian, axis=0)
    scaled = jacobian * scale
    step = np.linalg.solve(scaled.T @ scaled, -scaled.T @ residual)
    cost, share = float(residual @ residual) * (1.0 + 1e-12), 1.0
    while True:
        trial = x + share * scale * step
        there = _evaluate(problem, trial, weights)
        if float(there[0] @ there[0]) <= cost or share < 1e-3:
            return trial, there, float(np.abs(step).max()) < 1e-6
        share *= 0.5


def _summary(x: FloatArray, weights: FloatArray, here: Evaluation) -> PositionFit:
    residual, jacobian, field = here
    scale = 1.0 / np.linalg.norm(jacobian, axis=0)
    scaled = jacobian * scale
    covariance = np.linalg.inv(scaled.T @ scaled) * np.outer(scale, scale)
    # What the fit cannot absorb of each measurement adds up to the degrees of freedom.
    measured = 4 * len(field) - 1
    rows = jacobian[:measured]
    absorbed = float(((rows @ covariance) * rows).sum())
    return PositionFit(
        state=x,
        covariance=covariance,
        residual=field,
        jacobian=jacobian,
        weights=weights,
        cost=float(residual @ residual),
        chi_square=float(residual[:measured] @ residual[:measured]),
        freedom=max(round(measured - absorbed), 0),
    )


def leaning_error(problem: PositionProblem, fit: PositionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same in every dwell, adds to the state, (P, 2).

    By roll and by pitch, one sigma each. No agreement between the dwells shows it, and no further dwell
    averages it out: on the level it looks like an offset.
    """
    leaning = problem.whiten @ problem.leaning * np.sqrt(fit.weights)[:, np.newaxis, np.newaxis]
    return common_error(leaning, fit.covariance, fit.jacobian)


def common_error(whitened: FloatArray, covariance: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return what errors common to all readings, whitened as these, (K, 3, M), add to the state, (P, M).

    The readings' rows are the first of the whitened Jacobian (R, P).
    """
    rows = whitened.reshape(-1, whitened.shape[2])
    return np.asarray(covariance @ jacobian[: len(rows)].T @ rows)


def _weights(problem: PositionProblem, field: FloatArray) -> FloatArray:
    distance = (np.einsum("kij,kj->ki", problem.whiten, field) ** 2).sum(axis=1)
    return np.asarray(np.minimum(1.0, _MANY_SIGMAS_3D / np.maximum(distance, 1e-12)))


@dataclass(frozen=True, slots=True, eq=False)
class Blend:
    state: FloatArray
    covariance: FloatArray
    shared: FloatArray
    cross_probability: tuple[float, float]


def weigh_cross_terms(
    state: FloatArray, covariance: FloatArray, prior: IronPrior, shared: FloatArray | None = None
) -> Blend:
    """Weigh 'there are cross terms' against 'there are a sensor's own at the most' and blend the two.

    Both are one Gaussian: with the narrow prior is the fit with one more observation, that they are 0 within
    `narrow`, 1 / own^2 = 1 / cross^2 + 1 / narrow^2. The odds are the density of that observation after over
    that before the data (Savage and Dickey), times the prior odds. Where the data cannot tell, the blend
    costs less than either: a cross term that is not there is not paid for.

    No sensor's axes are square to nothing: taken for exactly so, a tilt that all readings share, which shows
    like a cross term, would count as known.

    `shared` (P, M) are errors of the state, one sigma each, that are no cross terms and tell nothing of them.
    """
    shared = np.zeros((state.size, 0)) if shared is None else shared
    horizontal, state, covariance, shared = _spike_and_slab(state, covariance, shared, [6], prior)
    vertical, state, covariance, shared = _spike_and_slab(state, covariance, shared, [7, 8], prior)
    return Blend(state, covariance + shared @ shared.T, shared, (horizontal, vertical))


def _spike_and_slab(
    state: FloatArray, covariance: FloatArray, shared: FloatArray, index: list[int], prior: IronPrior
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Blend a Gaussian with itself under the narrow prior of `state[index]`; P(wide) and the blend."""
    narrow2 = 1.0 / (prior.own_cross_sigma**-2.0 - prior.cross_sigma**-2.0)
    block = covariance[np.ix_(index, index)] + narrow2 * np.eye(len(index))
    value = state[index]
    gain = covariance[:, index] @ np.linalg.inv(block)
    posterior = -0.5 * float(value @ np.linalg.solve(block, value)) - 0.5 * float(np.linalg.slogdet(block)[1])
    before = -0.5 * len(index) * math.log(prior.cross_sigma**2 + narrow2)
    odds = math.log((1.0 - CROSS_TERMS_BEFORE) / CROSS_TERMS_BEFORE)
    log_odds = min(max(posterior - before + odds, -700.0), 700.0)
    spike = 1.0 / (1.0 + math.exp(-log_odds))
    shift = -gain @ value
    blended = state + spike * shift
    reduced = covariance - spike * gain @ covariance[index, :]
    spread = spike * (1.0 - spike) * np.outer(shift, shift)
    return 1.0 - spike, blended, reduced + spread, shared - spike * gain @ shared[index]
