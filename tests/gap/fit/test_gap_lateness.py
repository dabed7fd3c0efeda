"""What makes readings late is found though the age of telemetry would hide it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.fit.starts import beside_known_age, in_place_of_each_other
from mavcompass.gap.replay.nuisance import AGE, WORLD_FIELD, Nuisance
from mavcompass.simulation.effects import registry
from mavcompass.simulation.effects.effect import NEVER_S


def term_of(name: str) -> Term:
    effect = registry.get(name)
    low, high = np.array([(p.low, p.high) for p in effect.parameters]).T
    return Term(effect, np.ones(low.size, dtype=np.bool_), low, high)


LAG, LOW_PASS, EDDY, IRON, STEP = map(
    term_of, ("transport_lag", "low_pass", "eddy_current", "hard_iron", "hard_iron_step")
)
TERMS = (LAG, LOW_PASS, EDDY, IRON)


class Problem:
    """Take what is to be fitted as it is, and write it down."""

    def __init__(self) -> None:
        field = Nuisance.of(WORLD_FIELD, np.zeros(3), np.full(3, 5.0))
        age = Nuisance.of(AGE, np.array([0.05]), np.array([0.01]))
        self.nuisances = (field, age)
        self.asked: list[Fit] = []

    def fit(self, terms: Any, thetas: Any, nuisance_thetas: Any, iterations: int) -> Fit:
        self.asked.append(Fit(tuple(terms), tuple(thetas), tuple(nuisance_thetas), 50.0))
        return self.asked[-1]


def without_effects(late_s: float) -> Fit:
    return Fit((), (), (np.array([9.0, 0.0, 0.0]), np.array([0.05 + late_s])), 100.0)


def test_each_is_fitted_from_the_known_age_with_what_bent_it() -> None:
    problem: Any = Problem()
    null = without_effects(0.08)
    fits = beside_known_age(problem, TERMS, null, null.nuisance_thetas)
    assert fits == problem.asked and [sorted(f.ids) for f in fits] == [
        ["transport_lag"], ["low_pass"], ["eddy_current"]
    ]  # fmt: skip
    for fit in fits:
        assert [theta.tolist() for theta in fit.nuisance_thetas] == [[9.0, 0.0, 0.0], [0.05]]
    lag, low_pass, eddy = (fit.thetas[0] for fit in fits)
    assert lag == pytest.approx([0.08]) and low_pass == pytest.approx([0.08])
    # A hull that is alike in all three axes, and nothing between them.
    assert eddy == pytest.approx([0.08, 0.08, 0.08, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("late_s", [0.002, -0.08])
def test_an_age_that_is_not_bent_that_way_hides_nothing(late_s: float) -> None:
    problem: Any = Problem()
    null = without_effects(late_s)
    assert beside_known_age(problem, TERMS, null, null.nuisance_thetas) == [] == problem.asked


def test_without_an_age_of_telemetry_nothing_is_hidden() -> None:
    problem: Any = SimpleNamespace(nuisances=())
    assert beside_known_age(problem, TERMS, Fit((), (), (), 1.0), ()) == []


def step_and(term: Term, theta: list[float], on_s: float) -> Fit:
    step = np.array([9.0, 0.0, 0.0, on_s, NEVER_S])
    return Fit((STEP, term), (step, np.array(theta)), without_effects(0.0).nuisance_thetas, 100.0)


def test_a_moment_moves_with_what_makes_readings_late() -> None:
    """A step that is seen at 30 s beside a hull was 0.08 s earlier, if readings are late instead."""
    problem: Any = Problem()
    seen = step_and(EDDY, [0.07, 0.08, 0.09, 0.0, 0.0, 0.0], 30.0)
    lag, low_pass = in_place_of_each_other(problem, TERMS, seen)
    assert lag.ids == {"hard_iron_step", "transport_lag"} and low_pass.ids == {"hard_iron_step", "low_pass"}
    assert lag.theta("hard_iron_step")[3:] == pytest.approx([29.92, NEVER_S])
    assert low_pass.theta("hard_iron_step")[3:] == pytest.approx([30.0, NEVER_S])
    assert lag.theta("transport_lag") == low_pass.theta("low_pass") == pytest.approx([0.08])


def test_and_back_again() -> None:
    problem: Any = Problem()
    _, eddy = in_place_of_each_other(problem, TERMS, step_and(LAG, [0.08], 29.92))
    assert eddy.theta("hard_iron_step")[3] == pytest.approx(30.0)
    assert eddy.theta("eddy_current")[:3] == pytest.approx([0.08] * 3)


def test_what_is_late_already_takes_no_second_place() -> None:
    problem: Any = Problem()
    both = Fit((LAG, LOW_PASS), (np.array([0.1]), np.array([0.2])), without_effects(0.0).nuisance_thetas, 9.0)
    assert {f.ids for f in in_place_of_each_other(problem, TERMS, both)} == {
        frozenset({"eddy_current", "low_pass"}),
        frozenset({"eddy_current", "transport_lag"}),
    }
    iron = Fit((IRON,), (np.zeros(3),), without_effects(0.0).nuisance_thetas, 9.0)
    assert in_place_of_each_other(problem, TERMS, iron) == []
