"""What else is said of a vehicle whose compass is mounted in another orientation."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import Label
from mavcompass.gap.trial.score import Answer, score
from mavcompass.gap.trial.vehicles import make_case


# What a turned compass changes is 293, 470 and 620 mG; the other effects 6, 31 and 50.
@pytest.mark.parametrize(
    ("seed", "beside", "within"),
    [
        (1217082270, "hysteresis", {"rel": 0.1}),  # 6.4 and 60 mG
        (615621390, "cross_axis", {"abs": 0.02}),
        (1223982451, "field_gradient", {"abs": 0.1}),
    ],
)
def test_small_effect_beside_a_turned_compass_is_named(
    seed: int, beside: str, within: dict[str, float]
) -> None:
    case = make_case(seed, "pair")
    found = diagnose_gap(case.track, case.baseline)
    assert [cause.effect for cause in found.causes] == ["orientation", beside]
    named = found.causes[1]
    for name, true in dict(case.effects)[beside].items():
        assert named.parameters[name] == pytest.approx(true, **within)
        # Its attitude wanders, so that readings of seconds err together: what is stated says so.
        sigma = (named.ci95[name][1] - named.ci95[name][0]) / 3.92
        assert abs(named.parameters[name] - true) < 3.0 * sigma
    assert found.verdict in ("named", "ambiguous")
    (ids, probability), *_ = found.ambiguity_set
    assert ids == tuple(sorted(("orientation", beside))) and probability > 0.8
    assert found.field.after < found.field.floor


def test_distance_of_a_pair_keeps_its_turn_of_the_mounting() -> None:
    """What is left of a pair without its other member is a turned compass, not one that nothing explains."""
    case = make_case(2092035597, "pair")
    effects = tuple(
        f"{name}:" + ",".join(f"{key}={value:.9g}" for key, value in values.items())
        for name, values in case.effects
    )
    nothing = Answer("unknown", (), (), 1.0, 1.0, 0.0, (0.0, 0.0), 1.0)
    scored = score(Label("pair", "copter lanes", 2092035597, effects, generator="vehicles"), nothing, None)
    assert 5.0 < scored.separation < 50.0  # without the turn 856


@pytest.mark.parametrize("seed", [1023359753, 702557232])
def test_autopilot_that_steers_by_a_turned_compass_accuses_no_gyro(seed: int) -> None:
    """The other is a level rover that stands and turns: of its yaw nothing tells but the compass itself."""
    case = make_case(seed, "single")
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
