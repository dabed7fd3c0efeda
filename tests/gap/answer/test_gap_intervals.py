"""Within which values parameters are said to lie, against closed forms and other people's vehicles."""

from __future__ import annotations

import math

import pytest

from mavcompass.gap.answer.naming import _as_well
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.simulation.effects.effect import Parameter

ANY = Parameter("threshold", "A", -1e3, 1e3, 0.5, 0.0)


@pytest.mark.parametrize(("value", "sigma"), [(1.0, 0.2), (-40.0, 3.0), (0.0, 1e-3), (250.0, 0.01)])
def test_values_that_fit_as_well_are_those_of_a_parabola(value: float, sigma: float) -> None:
    low, high = _as_well(lambda x: ((x - value) / sigma) ** 2, ANY, value)
    assert (value - low, high - value) == pytest.approx((1.96 * sigma, 1.96 * sigma), rel=2e-3)


def test_a_threshold_lies_anywhere_between_the_loads_on_its_sides() -> None:
    found = _as_well(lambda x: 0.0 if 3.0 < x < 4.5 else 60.0, ANY, 3.9)
    assert found == pytest.approx((3.0, 4.5), abs=2e-3)


def test_values_end_where_the_parameter_does() -> None:
    assert _as_well(lambda x: 0.0, ANY, 3.9) == (-1e3, 1e3)
    assert _as_well(lambda x: 60.0 * (x < 3.0), ANY, 1e3) == pytest.approx((3.0, 1e3), abs=0.5)


@pytest.mark.parametrize("seed", [151118, 151139, 152412, 152425])
def test_interval_of_what_is_named_holds_what_was_put_in(seed: int) -> None:
    """Angles that are hardly there; a switch, whose load is recorded otherwise; a gradient in a flight
    whose attitude wanders."""
    case = make_case(seed, "single")
    ((effect, true),) = case.effects
    found = {cause.effect: cause for cause in diagnose_gap(case.track, case.baseline).causes}[effect]
    hits = 0
    for name, (low, high) in found.ci95.items():
        assert low <= found.parameters[name] <= high
        if name in ("source", "on_iron"):
            assert low == high == found.parameters[name]
            continue
        assert low < high
        if name == "threshold":
            assert math.isfinite(high - low)
            continue
        sigma = (high - low) / 3.92
        assert abs(found.parameters[name] - true[name]) < 3.1 * sigma
        hits += int(low <= true[name] <= high)
    assert hits >= 3
