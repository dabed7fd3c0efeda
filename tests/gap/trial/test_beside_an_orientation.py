"""What else is said of a vehicle whose compass is mounted in another orientation."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay import replay
from mavcompass.gap.trial.vehicles import make_case


def test_small_effect_beside_a_turned_compass_is_named() -> None:
    # A compass that is turned by 270 degrees changes 293 mG, its hysteresis 6.
    case = make_case(1217082270, "pair")
    found = diagnose_gap(case.track, case.baseline)
    assert [cause.effect for cause in found.causes] == ["orientation", "hysteresis"]
    true = dict(case.effects)["hysteresis"]
    assert dict(found.causes[1].parameters) == pytest.approx(true, rel=0.1)
    assert found.verdict == "ambiguous"
    assert dict(found.ambiguity_set) == {("hysteresis", "orientation"): 1.0}
    assert found.field.after < found.field.floor


def test_autopilot_that_steers_by_a_turned_compass_accuses_no_gyro() -> None:
    case = make_case(1023359753, "single")
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict == "named"
    assert [cause.effect for cause in found.causes] == ["orientation"]


@pytest.mark.parametrize("seed", [1208850555, 1042849402])
def test_gyro_stays_what_it_is_where_a_turned_compass_leans_the_autopilot(seed: int) -> None:
    case = make_case(seed, "single")
    assert [effect for effect, _ in case.effects] == ["orientation"] and case.baseline is not None
    flight, before = (replay(track).reference.gyro_bias for track in (case.track, case.baseline))
    assert flight is not None and before is not None
    np.testing.assert_allclose(flight.mean, before.mean, atol=0.006)
