"""Two effects of which one hides or bends what is seen of the other."""

from __future__ import annotations

import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.result import Cause
from mavcompass.gap.trial.vehicles import make_case


def told(seed: int) -> tuple[dict[str, Cause], dict[str, dict[str, float]], str]:
    case = make_case(seed, "pair")
    found = diagnose_gap(case.track, case.baseline)
    assert found.field.after < 1.05 * found.field.floor
    return {c.effect: c for c in found.causes}, {n: dict(v) for n, v in case.effects}, found.verdict


@pytest.mark.parametrize(
    ("seed", "beside"),
    [(67445025, "low_pass")],
)
def test_a_relay_is_told_again_once_what_is_beside_it_is_known(seed: int, beside: str) -> None:
    """A low pass smooths each switching."""
    found, true, _ = told(seed)
    assert found.keys() == true.keys() == {"relay_field", beside}
    relay = found["relay_field"]
    for axis in "xyz":
        sigma = (relay.ci95[axis][1] - relay.ci95[axis][0]) / 3.92
        assert abs(relay.parameters[axis] - true["relay_field"][axis]) < max(3.0 * sigma, 3.0)


def test_a_clipped_compass_that_is_mounted_askew_is_not_three_other_things() -> None:
    """Beside nothing clipping bends what the others do: oblique axes and soft iron did best there."""
    found, true, verdict = told(1206094773)
    assert found.keys() == true.keys() == {"misalignment", "clipping"}
    assert verdict == "named"
    for axis in "xyz":
        assert found["misalignment"].parameters[axis] == pytest.approx(true["misalignment"][axis], abs=0.006)


def test_what_does_far_better_beside_the_other_effect_is_among_the_answers() -> None:
    """A relay of 7 mG beside a gradient: two effects of the motors were the best that the search came by."""
    case = make_case(1606717870, "pair")
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict == "ambiguous"
    assert ("field_gradient", "relay_field") in dict(found.ambiguity_set)


def test_no_reading_of_both_on_and_off_counts_as_it_is_told_at_last() -> None:
    """One such reading of 200 that were not fitted, off by all of the 57 mG, was a remainder."""
    case = make_case(1012451560, "single")
    found = diagnose_gap(case.track, case.baseline)
    assert [c.effect for c in found.causes] == ["relay_field"] and found.verdict == "named"
    assert found.field.after < found.field.floor
