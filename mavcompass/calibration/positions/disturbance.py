"""Was one of the positions disturbed? Weigh every dwell against "none was", and let the answer follow.

A car that passes, or steel beside one position, adds an unknown field d to one dwell. Each hypothesis "dwell
j was disturbed" is the same Gaussian fit with that dwell's covariance widened by that of d, so its
estimate and its likelihood follow from the one fit without fitting again. The answer is the mixture:
with many positions the disturbed one is left out; with four, several may be suspect, and the heading's
sigma grows by how much their answers differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.positions.fit import PositionFit, fit_positions
from mavcompass.calibration.positions.problem import PositionProblem
from mavcompass.frames import FloatArray

# How often a position is disturbed at all, and how large such fields are: steps of a ladder.
DISTURBED_RUNS = 0.05
SIZES_MGAUSS = (3.0, 10.0, 30.0, 100.0)
REFIT_SIZES_MGAUSS = (5.0, 40.0)
_LOOK_CLOSER = 0.2
# A disturbance less likely than this is left out of the answer: its far tail would widen a sigma that is
# meant to cover two thirds, not the rare exception.
_NEGLIGIBLE = 0.1
_FREE = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class DisturbanceBlend:
    """Hold the mixture over "no dwell was disturbed" and "dwell j was".

    Attributes:
        state, covariance: of the mixture.
        probability: of each dwell having been disturbed, (K,).
        size_mgauss: how far each dwell's field is from what the others predict, (K,).
        chi_square, freedom: of the likeliest hypothesis.
    """

    state: FloatArray
    covariance: FloatArray
    probability: FloatArray
    size_mgauss: FloatArray
    chi_square: float
    freedom: int


@dataclass(slots=True)
class _Hypotheses:
    """Collect the hypotheses: which dwell (-1: none), log probability, state, covariance."""

    owners: list[int]
    weights: list[float]
    states: list[FloatArray]
    covariances: list[FloatArray]

    def add(self, owner: int, weight: float, state: FloatArray, covariance: FloatArray) -> None:
        self.owners.append(owner)
        self.weights.append(weight)
        self.states.append(state)
        self.covariances.append(covariance)

    def shares(self) -> FloatArray:
        share = np.exp(np.array(self.weights) - max(self.weights))
        return np.asarray(share / share.sum())

    def probability(self, count: int) -> FloatArray:
        share, owners = self.shares(), np.array(self.owners)
        return np.array([share[owners == j].sum() for j in range(count)])


def weigh_disturbances(problem: PositionProblem, fit: PositionFit) -> DisturbanceBlend:
    """Blend the fit with those in which one dwell is disturbed, by their probabilities.

    Where the quick (linear) look finds a disturbance likely, the hypotheses are fitted one by one.
    """
    k = len(problem.mean)
    hypotheses, sizes = _linear(problem, fit)
    best = fit
    if float(hypotheses.probability(k).sum()) > _LOOK_CLOSER:
        hypotheses, best = _refitted(problem, fit)
    if float(hypotheses.probability(k).sum()) < _NEGLIGIBLE:
        state, covariance = fit.state, fit.covariance
    else:
        share = hypotheses.shares()
        state, covariance = _mixture(share, np.array(hypotheses.states), np.array(hypotheses.covariances))
    return DisturbanceBlend(
        state=state,
        covariance=covariance,
        probability=hypotheses.probability(k),
        size_mgauss=sizes,
        chi_square=best.chi_square,
        freedom=best.freedom,
    )


def _linear(problem: PositionProblem, fit: PositionFit) -> tuple[_Hypotheses, FloatArray]:
    """Weigh the hypotheses from the one fit; returns them and how far each dwell is off, (K,)."""
    k = len(problem.mean)
    odds = math.log(DISTURBED_RUNS / (k * len(SIZES_MGAUSS)))
    hypotheses = _Hypotheses([-1], [math.log(1.0 - DISTURBED_RUNS)], [fit.state], [fit.covariance])
    sizes = np.zeros(k)
    for j in range(k):
        rows = fit.jacobian[3 * j : 3 * j + 3]
        residual = problem.whiten[j] @ fit.residual[j] * math.sqrt(fit.weights[j])
        spared = np.eye(3) - rows @ fit.covariance @ rows.T
        values, vectors = np.linalg.eigh(0.5 * (spared + spared.T))
        seen = values > _FREE
        if not seen.any():
            continue
        basis = vectors[:, seen]
        alone = basis @ ((basis.T @ residual) / values[seen])  # what the other dwells leave over
        sizes[j] = float(np.linalg.norm(np.linalg.solve(problem.whiten[j], alone)))
        for size in SIZES_MGAUSS:
            widened = size**2 * problem.whiten[j] @ problem.whiten[j].T
            state, covariance = _widened(fit, rows, residual, widened)
            weight = odds + _log_ratio(residual, values[seen], basis, widened)
            hypotheses.add(j, weight, state, covariance)
    return hypotheses, sizes


def _refitted(problem: PositionProblem, fit: PositionFit) -> tuple[_Hypotheses, PositionFit]:
    """Fit each hypothesis on its own; returns them and the likeliest fit. Laplace's evidence weighs them."""
    k = len(problem.mean)
    odds = math.log(DISTURBED_RUNS / (k * len(REFIT_SIZES_MGAUSS)))
    first = math.log(1.0 - DISTURBED_RUNS) + _evidence(problem, fit)
    hypotheses = _Hypotheses([-1], [first], [fit.state], [fit.covariance])
    fits = [fit]
    for j in range(k):
        for size in REFIT_SIZES_MGAUSS:
            loosened = problem.loosened(j, size)
            trial = fit_positions(loosened)
            hypotheses.add(j, odds + _evidence(loosened, trial), trial.state, trial.covariance)
            fits.append(trial)
    return hypotheses, fits[int(np.argmax(hypotheses.weights))]


def _evidence(problem: PositionProblem, fit: PositionFit) -> float:
    """Return the logarithm of the evidence up to a constant: fit, weights, and the room left to the state."""
    weights = float(np.linalg.slogdet(problem.whiten)[1].sum())
    scale = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(scale, scale)
    room = float(np.log(scale).sum()) + 0.5 * float(np.linalg.slogdet(correlation)[1])
    return -0.5 * fit.cost + weights + room


def _widened(
    fit: PositionFit, rows: FloatArray, residual: FloatArray, widened: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Give one dwell the covariance I + D (whitened): its weight falls by G = D (I + D)^-1."""
    lost = widened @ np.linalg.inv(np.eye(3) + widened)
    across = fit.covariance @ rows.T
    inner = np.linalg.inv(np.eye(3) - rows @ across @ lost)
    covariance = fit.covariance + across @ lost @ inner @ across.T
    covariance = 0.5 * (covariance + covariance.T)
    return fit.state + covariance @ rows.T @ (lost @ residual), covariance


def _log_ratio(residual: FloatArray, values: FloatArray, basis: FloatArray, widened: FloatArray) -> float:
    """Return the log likelihood ratio of the residual, disturbed against not.

    Undisturbed it has the covariance B = I - leverage; disturbed B + B D B. Both are restricted to the
    directions that the fit leaves free.
    """
    free = basis.T @ residual
    plain = np.diag(values)
    bent = plain + plain @ (basis.T @ widened @ basis) @ plain
    return 0.5 * float(
        free @ (free / values)
        - free @ np.linalg.solve(bent, free)
        + np.log(values).sum()
        - np.linalg.slogdet(bent)[1]
    )


def _mixture(share: FloatArray, states: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean = share @ states
    apart = states - mean
    spread = (apart * share[:, np.newaxis]).T @ apart
    return mean, np.tensordot(share, covariances, axes=1) + spread
