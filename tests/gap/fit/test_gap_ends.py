"""A fit ends where no step gains anything; how far it bends what is known, and how seldom chance does so."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit.composition import Composition
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, make_track
from mavcompass.simulation.effects import catalogue, parse

TRUE = "hard_iron:x=25,y=-10,z=5"


def problem_of(*texts: str) -> Problem:
    effects = [parse(text) for text in texts]
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=8.0, seed=6), effects))
    return Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return problem_of(TRUE)


@pytest.fixture(scope="module")
def plain() -> Problem:
    return problem_of()


def fitted(problem: Problem, *start: float) -> Fit:
    term = make_term(catalogue()["hard_iron"], problem.replay.signals)
    return problem.fit(Fit((term,), (np.array(start),), problem.prior.mean))


def test_from_wherever_it_began_a_fit_ends_in_the_same_place(problem: Problem) -> None:
    near, far = fitted(problem, 24.0, -9.0, 5.0), fitted(problem, -400.0, 300.0, 200.0)
    assert near.sse == pytest.approx(far.sse, abs=0.1)
    sigma = np.sqrt(np.diag(near.covariance)[-3:])
    assert (np.abs(near.thetas[0] - far.thetas[0]) < 0.2 * sigma).all()


def test_no_small_step_away_from_its_end_leaves_less(problem: Problem) -> None:
    end = fitted(problem, 0.0, 0.0, 0.0)
    for axis in np.eye(3):
        for step in (-2.0, 2.0):
            beside = problem.fit(replace(end, thetas=(end.thetas[0] + step * axis,)), 0)
            assert beside.sse > end.sse


def test_what_came_to_its_end_stays_but_on_other_rows(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    end, begun = fitted(problem, 0.0, 0.0, 0.0), fitted(problem, 400.0, 0.0, 0.0)
    some = problem.with_rows(problem.rows & (np.arange(problem.rows.size) % 2 == 0))
    runs, states = list[int](), Composition.states

    def counted(*args: Any, **more: Any) -> Any:
        runs.append(1)
        return states(*args, **more)

    monkeypatch.setattr(Composition, "states", counted)
    assert problem.refit(end) is end and not runs
    assert problem.refit(begun).sse <= begun.sse
    assert some.refit(end) is not end and runs


def bent(plain: Problem, sigmas: float) -> Fit:
    """Return a fit whose known parameters are off by so many of their sigmas."""
    prior = plain.prior
    root = np.linalg.cholesky(np.linalg.inv(prior.precision))
    return Fit(nuisances=prior.mean + prior.known * (root @ np.full(prior.mean.size, sigmas)))


def test_what_is_where_it_is_known_to_be_is_no_surprise(plain: Problem) -> None:
    assert plain.chance_of_mahalanobis2(bent(plain, 0.0)) == 1.0


def test_chance_bends_as_the_chi_squared_law_says(plain: Problem) -> None:
    known = int(plain.prior.known.sum())
    assert known > 0
    chances = [plain.chance_of_mahalanobis2(bent(plain, sigmas)) for sigmas in (0.5, 1.0, 2.0, 4.0)]
    assert chances == sorted(chances, reverse=True)
    # A draw of independent errors exceeds its own strain as often as it says.
    rng = np.random.default_rng(5)
    strains = np.sum(rng.standard_normal((4000, known)) ** 2, axis=1)
    for sigmas, told in zip((0.5, 1.0), chances, strict=False):
        fit = bent(plain, sigmas)
        share = float(np.mean(strains > plain.mahalanobis2(fit)))
        assert told == pytest.approx(share, abs=4.0 * math.sqrt(0.25 / 4000))
