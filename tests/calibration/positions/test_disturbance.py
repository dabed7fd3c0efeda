"""Which position was disturbed: against Bayes' rule for a model that is linear, where it is exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
import scipy

from mavcompass.calibration.positions import problem as positions
from mavcompass.calibration.positions.problem import (
    DISTURBED_RUNS,
    SIZES_MGAUSS,
    Mixture,
    PositionProblem,
    weigh_disturbances,
)
from mavcompass.calibration.rigid import Fit
from mavcompass.frames import FloatArray

K, STATES = 5, 4
PRIOR = np.diag([400.0, 100.0, 25.0, 900.0])
AT = np.random.default_rng(7).normal(size=(K, 3, STATES))
NOISE = np.array([np.diag([4.0, 9.0, 2.0]) + 0.5 * k for k in range(K)])  # covariance of each dwell, mG^2


@dataclass(frozen=True)
class Linear:
    """y_k = AT_k x + e_k, e_k of covariance NOISE_k, x of covariance PRIOR around 0."""

    mean: FloatArray
    noise: FloatArray

    @property
    def whiten(self) -> FloatArray:
        return np.linalg.inv(np.linalg.cholesky(self.noise))

    @property
    def readings(self) -> FloatArray:
        return self.mean

    def loosened(self, index: int, size: float) -> Linear:
        noise = self.noise.copy()
        noise[index] += size**2 * np.eye(3)
        return replace(self, noise=noise)

    def log_likelihood(self) -> float:
        at = AT.reshape(-1, STATES)
        covariance = at @ PRIOR @ at.T
        for k in range(K):
            covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += self.noise[k]
        return float(scipy.stats.multivariate_normal.logpdf(self.mean.ravel(), cov=covariance))

    def posterior(self) -> tuple[FloatArray, FloatArray]:
        weights = np.linalg.inv(self.noise)
        information = np.linalg.inv(PRIOR) + np.einsum("kia,kij,kjb->ab", AT, weights, AT)
        covariance = np.linalg.inv(information)
        return covariance @ np.einsum("kia,kij,kj->a", AT, weights, self.mean), covariance


def fitted(problem: Any, start: Fit | None = None) -> Fit:
    state, covariance = problem.posterior()
    residual, root = problem.mean - AT @ state, np.linalg.inv(np.linalg.cholesky(PRIOR))
    jacobian = np.concatenate([-(problem.whiten @ AT).reshape(-1, STATES), root])
    whitened = np.concatenate([np.einsum("kij,kj->ki", problem.whiten, residual).ravel(), root @ state])
    return Fit(state, covariance, residual, np.ones(K), problem.whiten, whitened, jacobian)


def exact(problem: Linear, sizes: tuple[float, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each dwell's probability of being disturbed, and the mixture's mean and covariance."""
    trials = [problem, *(problem.loosened(j, size) for size in sizes for j in range(K))]
    before = np.array([1.0 - DISTURBED_RUNS, *[DISTURBED_RUNS / (K * len(sizes))] * (K * len(sizes))])
    log = np.log(before) + [trial.log_likelihood() for trial in trials]
    share = np.exp(log - log.max())
    share /= share.sum()
    states, covariances = zip(*(trial.posterior() for trial in trials), strict=True)
    mean = share @ np.array(states)
    apart = np.array(states) - mean
    spread = sum(p * (c + np.outer(a, a)) for p, c, a in zip(share, covariances, apart, strict=True))
    return share[1:].reshape(-1, K).sum(axis=0), mean, np.asarray(spread)


def problem_with(field_mgauss: float, dwell: int = 2, seed: int = 3) -> Linear:
    chance = np.random.default_rng(seed)
    noise = [chance.multivariate_normal(np.zeros(3), covariance) for covariance in NOISE]
    mean = AT @ np.array([10.0, -5.0, 3.0, 20.0]) + noise
    mean[dwell] += field_mgauss * np.array([0.6, -0.48, 0.64])
    return Linear(mean, NOISE)


def weighed(problem: Linear) -> Mixture:
    return weigh_disturbances(cast(PositionProblem, problem), fitted(problem))


@pytest.fixture(autouse=True)
def linear(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(positions, "fit_positions", fitted)


@pytest.mark.parametrize("field_mgauss", [0.0, 6.0, 12.0, 60.0])
def test_the_mixture_is_that_of_bayes_rule(field_mgauss: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(positions, "_BY_CHANCE", 1.1)
    monkeypatch.setattr(positions, "_NEGLIGIBLE", 0.0)
    problem = problem_with(field_mgauss)
    mixture = weighed(problem)
    probability, mean, covariance = exact(problem, SIZES_MGAUSS)
    np.testing.assert_allclose(mixture.probability, probability, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(mixture.state, mean, rtol=1e-8)
    np.testing.assert_allclose(mixture.covariance, covariance, rtol=1e-7, atol=1e-9)


def test_what_chance_lets_disagree_costs_nothing_and_was_hardly_disturbed() -> None:
    calm = problem_with(0.0, seed=4)
    assert fitted(calm).chance > 0.05 and exact(calm, SIZES_MGAUSS)[0].sum() < 0.1
    mixture = weighed(calm)
    assert not mixture.probability.any()
    np.testing.assert_array_equal(mixture.state, fitted(calm).state)


def test_the_unlikely_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(positions, "_BY_CHANCE", 1.1)
    calm = problem_with(0.0)
    mixture = weighed(calm)
    assert 0.0 < mixture.probability.sum() < 0.1
    np.testing.assert_array_equal(mixture.state, fitted(calm).state)
    np.testing.assert_array_equal(mixture.covariance, fitted(calm).covariance)


def test_the_disturbed_dwell_is_named_with_its_size_and_left_out() -> None:
    hit = problem_with(60.0)
    mixture = weighed(hit)
    assert mixture.probability[2] > 0.99
    assert mixture.best.chi_square == pytest.approx(fitted(hit.loosened(2, 40.0)).chi_square)
    state, _ = hit.loosened(2, 1e5).posterior()
    assert mixture.size_mgauss[2] == pytest.approx(np.linalg.norm(hit.mean[2] - AT[2] @ state), rel=0.02)
