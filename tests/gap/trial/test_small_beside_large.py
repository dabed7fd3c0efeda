"""What is certain and too small to be named beside a large effect is told as another possibility."""

from __future__ import annotations

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles import make_case


def test_certain_effect_below_the_floor_is_in_the_set() -> None:
    # A compass that is turned by 270 degrees changes 293 mG, its hysteresis 6.
    case = make_case(1217082270, "pair")
    found = diagnose_gap(case.track, case.baseline)
    assert [cause.effect for cause in found.causes] == ["orientation"]
    assert found.verdict == "ambiguous"
    assert dict(found.ambiguity_set) == {("orientation",): 0.5, ("hysteresis", "orientation"): 0.5}
    assert found.field.after < 1.3 * found.field.floor
