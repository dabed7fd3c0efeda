"""How far a fit bends what is known of vehicle and place, and how seldom chance does so: chi-squared."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, make_track


@pytest.fixture(scope="module")
def problem() -> Problem:
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=8.0, seed=6), []))
    return Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)


def bent(problem: Problem, sigmas: float) -> Fit:
    """Return a fit whose known parameters are off by so many of their sigmas."""
    prior = problem.prior
    root = np.linalg.cholesky(np.linalg.inv(prior.precision))
    return Fit(nuisances=prior.mean + prior.known * (root @ np.full(prior.mean.size, sigmas)))


def test_what_is_where_it_is_known_to_be_is_no_surprise(problem: Problem) -> None:
    assert problem.chance_of_mahalanobis2(bent(problem, 0.0)) == 1.0


def test_chance_bends_as_the_chi_squared_law_says(problem: Problem) -> None:
    known = int(problem.prior.known.sum())
    assert known > 0
    chances = [problem.chance_of_mahalanobis2(bent(problem, sigmas)) for sigmas in (0.5, 1.0, 2.0, 4.0)]
    assert chances == sorted(chances, reverse=True)
    # A draw of independent errors exceeds its own strain as often as it says.
    rng = np.random.default_rng(5)
    strains = np.sum(rng.standard_normal((4000, known)) ** 2, axis=1)
    for sigmas, told in zip((0.5, 1.0), chances, strict=False):
        fit = bent(problem, sigmas)
        share = float(np.mean(strains > problem.mahalanobis2(fit)))
        assert told == pytest.approx(share, abs=4.0 * math.sqrt(0.25 / 4000))
