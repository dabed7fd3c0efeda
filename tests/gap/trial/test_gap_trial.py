"""The blind trial: seals, scores."""

from __future__ import annotations

import math

import pytest

from mavcompass.chance import wilson
from mavcompass.errors import UsageError
from mavcompass.gap.trial.cases import Label, Tier
from mavcompass.gap.trial.trial import Answer, Case, run_trial, score, untold
from mavcompass.gap.trial.vehicles import make_case


def test_a_case_tells_nothing_of_its_truth() -> None:
    case = make_case(4, "single")
    track = untold(case.track)
    assert track.truth_q is None and case.track.truth_q is not None
    assert track.parameters == case.track.parameters and track.compasses == case.track.compasses
    assert not any(name in f"{track.source} {track.notes}" for name, _ in case.effects)


def test_interval_of_a_share_holds_it() -> None:
    low, high = wilson(8, 1100)
    assert math.isclose(low, 0.0037, abs_tol=3e-4) and math.isclose(high, 0.0143, abs_tol=3e-4)


def test_vehicles_are_sealed_and_scored_by_the_same_table() -> None:
    trial = run_trial(1, 13, "withheld", generator="vehicles")  # a short recording
    assert trial.to_json()["generator"] == "vehicles"
    (case,) = trial.cases
    assert len(trial.seal) == 64 and case.answer.after <= case.answer.nominal * (1.0 + 1e-9)
    assert case.withheld is not None and case.label.ids[0] not in case.withheld.effects
    assert 0.0 < case.separation <= case.label.size_sigma
    assert case.answer.cpu_seconds > 0.0
    assert trial.figures()["confident wrong names"][1] == 1


def test_a_name_is_wrong_if_it_is_neither_the_truth_nor_like_it() -> None:
    def wrong(truth: tuple[str, ...], verdict: str, *named: str) -> bool:
        answer = Answer(verdict, named, (), 2.0, 1.0, 0.5, (0.4, 0.6), 1.0)
        return Case(Label("single", "hand", 1, truth), answer, None, 20.0, False, False, 1.0).wrong_name

    assert wrong((), "named", "hard_iron") and wrong(("chirp:x=1",), "named", "hard_iron")
    assert not wrong(("hard_iron:x=9", "orientation:orientation=4"), "named", "hard_iron")
    assert not wrong((), "ambiguous", "hard_iron")


def test_a_tier_that_a_generator_does_not_have_is_refused() -> None:
    with pytest.raises(UsageError, match="no tier"):
        run_trial(1, 1, "outside")


def _scored(tier: Tier, motion: str, seed: int) -> Case:
    effects = tuple(
        f"{name}:" + ",".join(f"{key}={value:.9g}" for key, value in values.items())
        for name, values in make_case(seed, "pair" if tier == "pair" else "single").effects
    )
    nothing = Answer("unknown", (), (), 1.0, 1.0, 0.0, (0.0, 0.0), 1.0)
    return score(Label(tier, motion, seed, effects, generator="vehicles"), nothing, None)


def test_distance_is_not_what_another_makes_model_differs_by() -> None:
    """A current of 3 mG beside a switched field of 22: when it is switched telemetry tells badly, and no name
    explains that, the right one neither. What the current makes is what the calibration is known to."""
    scored = _scored("pair", "ackermann-rover figure_eight", 126177429)
    assert scored.truth_distance > 100.0
    assert scored.separation < 5.0


def test_effect_that_shows_a_part_of_itself_has_a_distance() -> None:
    scored = _scored("single", "rover circles", 968557406)
    assert scored.label.ids == ("non_orthogonality",) and scored.separation > 20.0


def test_effect_that_a_flight_cannot_test_has_none() -> None:
    label = Label(
        "single", "rover circles", 968557406, ("platform_tilt:about_north=0.05",), generator="vehicles"
    )
    scored = score(label, Answer("unknown", (), (), 1.0, 1.0, 0.0, (0.0, 0.0), 1.0), None)
    assert scored.separation == 0.0 and math.isnan(scored.truth_distance)
