"""How much a set of effects is worth beside another one: on sets without any data."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.fit.candidates import Criteria
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.simulation.effects import registry

LAG, LOW_PASS, HARD_IRON = (registry.get(name) for name in ("transport_lag", "low_pass", "hard_iron"))


def criteria(spread: float) -> Criteria:
    """Return criteria of fits whose one number is what they strain; blocks contradict each other."""
    problem: Any = SimpleNamespace(count=500, mahalanobis2=lambda fit: float(fit.nuisances[0]))
    found = Criteria(problem, "baseline")
    found.overdispersion = spread
    return found


def fit(left: float, strain: float, *effects: Any) -> Fit:
    """Return a fit that leaves so much of the readings, and bends what is known by so much."""
    sizes = [len(e.parameters) for e in effects]
    free = [np.ones(size, dtype=np.bool_) for size in sizes]
    terms = tuple(Term(e, f, np.zeros(n), np.ones(n)) for e, f, n in zip(effects, free, sizes, strict=True))
    return Fit(terms, tuple(np.full(n, 0.25) for n in sizes), np.array([strain]), left + strain)


@pytest.mark.parametrize("contradiction", [1.0, 5.0, 84.0])
def test_what_is_known_keeps_its_weight_however_blocks_contradict_each_other(contradiction: float) -> None:
    """Real errors last for seconds: they weaken what readings say, not what was measured of the vehicle."""
    one = criteria(contradiction)
    bent, straight = fit(7444.0, 1188.0), fit(7418.0, 32.0, LAG)
    assert one.score(bent) - one.score(straight) > 1000.0
    assert one.score(bent) == pytest.approx(7444.0 / contradiction + 1188.0)


def test_what_readings_gain_is_held_against_how_blocks_contradict_each_other() -> None:
    def cheaper(spread: float, left: float) -> bool:
        one = criteria(spread)
        return one.score(fit(left, 3.0, LAG)) < one.score(fit(1000.0, 3.0))

    assert cheaper(1.0, 900.0) and not cheaper(20.0, 900.0) and not cheaper(1.0, 995.0)


def test_what_bends_the_known_to_fit_readings_closer_is_not_needed() -> None:
    nothing, bent = fit(1000.0, 3.0), fit(800.0, 60.0, LAG)
    for spread, cheaper in ((1.0, True), (4.0, False)):
        one = criteria(spread)
        assert (one.score(bent) < one.score(nothing)) is cheaper
