"""Which position was disturbed: against Bayes' rule for a model that is linear, where it is exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
import scipy

from mavcompass.calibration.positions import disturbance
from mavcompass.calibration.positions.disturbance import (
    DISTURBED_RUNS,
    REFIT_SIZES_MGAUSS,
    SIZES_MGAUSS,
    weigh_disturbances,
)
from mavcompass.calibration.positions.problem import PositionFit, PositionProblem
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


def fitted(problem: Any, start: PositionFit | None = None) -> PositionFit:
    state, covariance = problem.posterior()
    residual = problem.mean - AT @ state
    rows = -(problem.whiten @ AT).reshape(-1, STATES)
    jacobian = np.concatenate([rows, np.linalg.inv(np.linalg.cholesky(PRIOR))])
    whitened = np.einsum("kij,kj->ki", problem.whiten, residual)
    cost = float((whitened**2).sum() + state @ np.linalg.solve(PRIOR, state))
    return PositionFit(state, covariance, residual, jacobian, np.ones(K), cost, cost, 3 * K)


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


def problem_with(field_mgauss: float, dwell: int = 2) -> Linear:
    chance = np.random.default_rng(3)
    noise = [chance.multivariate_normal(np.zeros(3), covariance) for covariance in NOISE]
    mean = AT @ np.array([10.0, -5.0, 3.0, 20.0]) + noise
    mean[dwell] += field_mgauss * np.array([0.6, -0.48, 0.64])
    return Linear(mean, NOISE)


def weighed(problem: Linear) -> disturbance.DisturbanceBlend:
    return weigh_disturbances(cast(PositionProblem, problem), fitted(problem))


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disturbance, "fit_positions", fitted)


@pytest.mark.parametrize("closer", [1e9, -1.0], ids=["from the one fit", "each fitted anew"])
@pytest.mark.parametrize("field_mgauss", [0.0, 6.0, 12.0, 60.0])
@pytest.mark.usefixtures("linear")
def test_the_mixture_is_that_of_bayes_rule(
    field_mgauss: float, closer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disturbance, "_LOOK_CLOSER", closer)
    monkeypatch.setattr(disturbance, "_NEGLIGIBLE", 0.0)
    problem = problem_with(field_mgauss)
    blend = weighed(problem)
    probability, mean, covariance = exact(problem, REFIT_SIZES_MGAUSS if closer < 0.0 else SIZES_MGAUSS)
    np.testing.assert_allclose(blend.probability, probability, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(blend.state, mean, rtol=1e-8)
    np.testing.assert_allclose(blend.covariance, covariance, rtol=1e-7, atol=1e-9)


@pytest.mark.usefixtures("linear")
def test_the_size_is_how_far_a_dwell_is_from_what_the_others_predict() -> None:
    problem = problem_with(60.0)
    sizes = weighed(problem).size_mgauss
    for j in range(K):
        state, _ = problem.loosened(j, 1e5).posterior()
        assert sizes[j] == pytest.approx(float(np.linalg.norm(problem.mean[j] - AT[j] @ state)), rel=1e-4)


@pytest.mark.usefixtures("linear")
def test_the_unlikely_is_left_out_and_the_likely_fitted_anew() -> None:
    calm, hit = problem_with(0.0), problem_with(60.0)
    blend = weighed(calm)
    assert 0.0 < blend.probability.sum() < 0.1
    np.testing.assert_array_equal(blend.state, fitted(calm).state)
    np.testing.assert_array_equal(blend.covariance, fitted(calm).covariance)
    assert blend.best.chi_square == fitted(calm).chi_square
    blend = weighed(hit)
    probability, mean, _ = exact(hit, REFIT_SIZES_MGAUSS)
    np.testing.assert_allclose(blend.probability, probability, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(blend.state, mean, rtol=1e-8)
    assert blend.best.chi_square == pytest.approx(fitted(hit.loosened(2, 40.0)).chi_square)


@pytest.mark.usefixtures("linear")
def test_a_dwell_that_no_other_looks_at_is_never_the_disturbed_one(monkeypatch: pytest.MonkeyPatch) -> None:
    at, prior = np.zeros((K, 3, 6)), np.eye(6) * 1e12
    at[:, :, :3] = np.eye(3)
    at[4] = np.concatenate([np.zeros((3, 3)), np.eye(3)], axis=1)  # three numbers of its own
    for name, value in (("AT", at), ("PRIOR", prior), ("STATES", 6)):
        monkeypatch.setitem(globals(), name, value)
    mean = np.tile([100.0, 0.0, 400.0], (K, 1))
    mean[4] += 300.0
    blend = weighed(Linear(mean, NOISE))
    assert blend.probability[4] == 0.0 and blend.size_mgauss[4] == pytest.approx(0.0, abs=1e-6)
