"""The four-position fit itself: Gauss-Newton, and how far cross terms are believed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.positions.problem import PositionProblem
from mavcompass.calibration.rigid import IronPrior, assembled, common_error, covariance_of, settle
from mavcompass.frames import FloatArray

_ROBUST_FROM, _ROUNDS, _STEPS_A_ROUND = 6, 20, 2
_MANY_SIGMAS_3D = 11.34  # chi-square of three, 99 %
# Before the data: most compasses away from steel have no cross terms that matter.
CROSS_TERMS_BEFORE = 0.25


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


def fit_positions(problem: PositionProblem, near: PositionFit | None = None) -> PositionFit:
    """Fit the positions; dwells far out weigh less where there are many.

    The fit of a problem that is nearly the same may be given to begin with.
    """
    readings = problem.readings
    x, weights = (problem.start, np.ones(len(readings))) if near is None else (near.state, near.weights)
    if len(readings) >= _ROBUST_FROM:
        for _ in range(_ROUNDS):
            x = settle(readings, x, _roots(problem, weights), problem.rules, _STEPS_A_ROUND)
            before, weights = weights, _weights(problem, readings.field(x)[0])
            if float(np.abs(weights - before).max()) < 1e-3:
                break
    roots = _roots(problem, weights)
    x = settle(readings, x, roots, problem.rules)
    residual, _ = readings.field(x)
    values, jacobian = assembled(readings, x, roots, problem.rules)
    covariance = covariance_of(jacobian)
    # What the fit cannot absorb of each measurement adds up to the degrees of freedom.
    measured = 4 * len(readings) - 1
    rows = jacobian[:measured]
    absorbed = float(((rows @ covariance) * rows).sum())
    return PositionFit(
        state=x,
        covariance=covariance,
        residual=residual,
        jacobian=jacobian,
        weights=weights,
        cost=float(values @ values),
        chi_square=float(values[:measured] @ values[:measured]),
        freedom=max(round(measured - absorbed), 0),
    )


def leaning_error(problem: PositionProblem, fit: PositionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same in every dwell, adds to the state, (P, 2).

    By roll and by pitch, one sigma each: on the level it looks like an offset.
    """
    leaning = problem.whiten @ problem.leaning * np.sqrt(fit.weights)[:, np.newaxis, np.newaxis]
    return common_error(leaning, fit.covariance, fit.jacobian)


def _roots(problem: PositionProblem, weights: FloatArray) -> FloatArray:
    return np.asarray(problem.whiten * np.sqrt(weights)[:, np.newaxis, np.newaxis])


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
