"""What else is said of a vehicle whose compass is mounted in another orientation."""

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


def test_autopilot_that_steers_by_a_turned_compass_accuses_no_gyro() -> None:
    case = make_case(1023359753, "single")
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict == "named"
    assert [cause.effect for cause in found.causes] == ["orientation"]
