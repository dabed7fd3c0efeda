"""The criterion, in closed form: what sets cost, which one leads, what says the same in more words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit.candidates import Criteria
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.selection.identification import Posterior, posterior_of
from mavcompass.gap.tables import tables
from mavcompass.simulation.effects import registry

ROWS, STRAIN = 400, 5.0
PENALTY = tables().penalty["baseline"]


def fit_of(*names: str, sse: float) -> Fit:
    effects = [registry.get(name) for name in names]
    terms = tuple(Term(e, np.ones(len(e.names), dtype=np.bool_), e.lower, e.upper) for e in effects)
    return Fit(terms, tuple(np.zeros(len(e.names)) for e in effects), (), sse)


@dataclass
class Problem:
    """Predict what each set's place in a list says."""

    predictions: dict[frozenset[str], float]
    count: int = ROWS

    def mahalanobis2(self, fit: Fit) -> float:
        return STRAIN

    def refit(self, fit: Fit) -> Fit:
        return fit

    def predict(self, fit: Fit) -> float:
        return self.predictions.get(fit.ids, 0.0)

    def shift(self, after: float, before: float) -> np.ndarray:
        return np.array([after - before])


def weighed(
    *fits: Fit, spread: float = 1.0, predictions: dict[frozenset[str], float] | None = None
) -> Posterior:
    problem: Any = Problem(predictions or {})
    criteria: Any = Criteria(problem, "baseline")
    criteria.overdispersion_of = lambda smaller, larger: spread
    explored = {f.ids: f for f in (fit_of(sse=2000.0), *fits)}
    search: Any = SimpleNamespace(problem=problem, criteria=criteria, explored=explored)
    return posterior_of(search)


@pytest.mark.parametrize("spread", [1.0, 4.0])
def test_a_set_costs_what_it_leaves_what_it_strains_and_what_it_needs(spread: float) -> None:
    iron = fit_of("hard_iron", sse=1000.0)
    told = weighed(iron, spread=spread)
    needs = 3.0 * PENALTY.parameter * math.log(ROWS) + PENALTY.effect
    assert told.best.fit is iron
    assert told.best.cost == pytest.approx((1000.0 - STRAIN) / spread + STRAIN + needs)
    problem: Any = Problem({})
    criteria = Criteria(problem, "baseline")
    criteria.overdispersion = spread
    assert criteria.score(iron) == pytest.approx(told.best.cost), "as the search weighs it"
    assert told.gain == pytest.approx(1000.0 / spread - needs)
    assert told.lead == pytest.approx(told.gain) and told.without("hard_iron") == pytest.approx(
        told.gain**0.5
    )


def test_errors_that_last_need_a_larger_gain() -> None:
    small = fit_of("hard_iron", sse=1800.0)
    assert weighed(small).gain > 0.0
    assert weighed(small, spread=10.0).best.fit.ids == frozenset() and weighed(small, spread=10.0).gain == 0.0


def test_the_same_in_more_words_is_no_rival() -> None:
    plain, wordy = fit_of("non_orthogonality", sse=1000.0), fit_of("misalignment", "soft_iron", sse=1000.0)
    other = fit_of("hard_iron", sse=1200.0)
    places = {plain.ids: 10.0, wordy.ids: 10.5, other.ids: 40.0}
    told = weighed(plain, wordy, other, predictions=places)
    assert told.best.fit is plain
    assert [e.fit.ids for e in told.explanations if told.restates(e)] == [wordy.ids]
    assert told.lead == pytest.approx(200.0 - _saved(plain, other))
    apart = weighed(plain, wordy, other, predictions={**places, wordy.ids: 30.0})
    assert not any(apart.restates(e) for e in apart.explanations)


def test_rivals_share_a_probability_by_what_they_cost() -> None:
    best, near, far = (
        fit_of(n, sse=s) for n, s in (("hard_iron", 900.0), ("motor_current", 902.0), ("clipping", 990.0))
    )
    told = weighed(best, near, far, predictions={near.ids: 50.0, far.ids: 90.0})
    shares = dict(told.weights(0.4))
    assert sum(shares.values()) == pytest.approx(0.4)
    assert shares[near.ids] > 0.399 > shares[far.ids]
    assert weighed(best).weights(0.4) == ()


def _saved(one: Fit, other: Fit) -> float:
    return PENALTY.parameter * math.log(ROWS) * (one.dimension - other.dimension)
