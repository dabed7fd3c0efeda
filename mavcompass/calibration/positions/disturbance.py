"""Was one of the positions disturbed? Weigh every dwell against "none was", and let the answer follow.

A car that passes, or steel beside one position, adds an unknown field d to one dwell. Each hypothesis "dwell
j was disturbed" is the same Gaussian fit with that dwell's covariance widened by that of d, so its
estimate and its likelihood follow from the one fit without fitting again. The answer is the mixture:
with many positions the disturbed one is left out; with four, several may be suspect, and the heading's
sigma grows by how much their answers differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.positions.problem import PositionFit, PositionProblem, fit_positions
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
_SIZES2 = np.square(SIZES_MGAUSS)


@dataclass(frozen=True, slots=True, eq=False)
class DisturbanceBlend:
    """Hold the mixture over "no dwell was disturbed" and "dwell j was".

    Attributes:
        state, covariance: of the mixture.
        probability: of each dwell having been disturbed, (K,).
        size_mgauss: how far each dwell's field is from what the others predict, (K,).
        best: the fit by the likeliest hypothesis.
    """

    state: FloatArray
    covariance: FloatArray
    probability: FloatArray
    size_mgauss: FloatArray
    best: PositionFit


@dataclass(frozen=True, slots=True, eq=False)
class _Hypotheses:
    """Hold the hypotheses: which dwell (-1: none), log probability, and how to get state and covariance."""

    owners: Sequence[int]
    weights: Sequence[float]
    fitted: Callable[[int], tuple[FloatArray, FloatArray]]

    def shares(self) -> FloatArray:
        share = np.exp(np.array(self.weights) - max(self.weights))
        return np.asarray(share / share.sum())

    def probability(self, count: int) -> FloatArray:
        share, owners = self.shares(), np.array(self.owners)
        return np.array([share[owners == j].sum() for j in range(count)])

    def mixture(self) -> tuple[FloatArray, FloatArray]:
        share = self.shares()
        states, covariances = zip(*(self.fitted(place) for place in range(len(share))), strict=True)
        mean = share @ np.array(states)
        apart = np.array(states) - mean
        spread = (apart * share[:, np.newaxis]).T @ apart
        return mean, np.tensordot(share, np.array(covariances), axes=1) + spread


def weigh_disturbances(problem: PositionProblem, fit: PositionFit) -> DisturbanceBlend:
    """Blend the fit with those in which one dwell is disturbed, by their probabilities.

    Where the quick (linear) look finds a disturbance likely, the hypotheses are fitted one by one.
    """
    k = len(problem.readings)
    hypotheses, sizes = _linear(problem, fit)
    best = fit
    if float(hypotheses.probability(k).sum()) > _LOOK_CLOSER:
        hypotheses, best = _refitted(problem, fit)
    probability = hypotheses.probability(k)
    unlikely = float(probability.sum()) < _NEGLIGIBLE
    state, covariance = (fit.state, fit.covariance) if unlikely else hypotheses.mixture()
    return DisturbanceBlend(state, covariance, probability, sizes, best)


def _linear(problem: PositionProblem, fit: PositionFit) -> tuple[_Hypotheses, FloatArray]:
    """Weigh the hypotheses from the one fit; returns them and how far each dwell is off, (K,)."""
    k = len(problem.readings)
    rows = fit.jacobian[: 3 * k].reshape(k, 3, -1)
    residual = np.einsum("kij,kj->ki", problem.whiten, fit.residual) * np.sqrt(fit.weights)[:, np.newaxis]
    spared = np.eye(3) - rows @ fit.covariance @ np.swapaxes(rows, 1, 2)
    values, vectors = np.linalg.eigh(spared)
    # A direction that the fit takes up whole tells nothing: it counts as undisturbed, with nothing left.
    seen = values > _FREE
    values = np.where(seen, values, 1.0)
    free = np.einsum("kij,ki->kj", vectors, residual) * seen
    alone = np.einsum("kij,kj->ki", vectors, free / values)  # what the other dwells leave over
    sizes = np.linalg.norm(np.linalg.solve(problem.whiten, alone[:, :, np.newaxis])[:, :, 0], axis=1)
    square = problem.whiten @ np.swapaxes(problem.whiten, 1, 2)
    turned = np.swapaxes(vectors, 1, 2) @ square @ vectors * (seen[:, :, np.newaxis] & seen[:, np.newaxis])
    grown = values[:, :, np.newaxis] * turned * values[:, np.newaxis]
    bent = _diagonal(values) + _SIZES2[:, np.newaxis, np.newaxis, np.newaxis] * grown  # (S, K, 3, 3)
    # The log likelihood ratio, disturbed against not. Undisturbed the residual has the covariance B = I -
    # leverage; disturbed B + B D B.
    solved = np.linalg.solve(bent, np.broadcast_to(free[:, :, np.newaxis], (*bent.shape[:3], 1)))[..., 0]
    ratio = 0.5 * (
        (free**2 / values).sum(axis=1)
        - (free * solved).sum(axis=2)
        + np.log(values).sum(axis=1)
        - np.linalg.slogdet(bent)[1]
    )
    ratio[:, ~seen.any(axis=1)] = -math.inf
    odds = math.log(DISTURBED_RUNS / (k * len(SIZES_MGAUSS)))

    def fitted(place: int) -> tuple[FloatArray, FloatArray]:
        if place == 0:
            return fit.state, fit.covariance
        size, j = divmod(place - 1, k)
        return _widened(fit, rows[j], residual[j], _SIZES2[size] * square[j])

    owners, weights = [-1, *np.tile(np.arange(k), len(_SIZES2)).tolist()], (odds + ratio).ravel().tolist()
    return _Hypotheses(owners, [math.log(1.0 - DISTURBED_RUNS), *weights], fitted), sizes


def _diagonal(values: FloatArray) -> FloatArray:
    return values[:, :, np.newaxis] * np.eye(values.shape[1])


def _refitted(problem: PositionProblem, fit: PositionFit) -> tuple[_Hypotheses, PositionFit]:
    """Fit each hypothesis on its own; returns them and the likeliest fit. Laplace's evidence weighs them."""
    k = len(problem.readings)
    odds = math.log(DISTURBED_RUNS / (k * len(REFIT_SIZES_MGAUSS)))
    owners, fits = [-1], [fit]
    weights = [math.log(1.0 - DISTURBED_RUNS) + _evidence(problem, fit)]
    for j in range(k):
        for size in REFIT_SIZES_MGAUSS:
            loosened = problem.loosened(j, size)
            trial = fit_positions(loosened, fit)
            owners.append(j)
            weights.append(odds + _evidence(loosened, trial))
            fits.append(trial)

    def fitted(place: int) -> tuple[FloatArray, FloatArray]:
        return fits[place].state, fits[place].covariance

    return _Hypotheses(owners, weights, fitted), fits[int(np.argmax(weights))]


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
