"""A fit ends where no step gains anything, and what came to its end is not fitted again."""

from __future__ import annotations

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


@pytest.fixture(scope="module")
def problem() -> Problem:
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=8.0, seed=6), [parse(TRUE)]))
    return Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)


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
