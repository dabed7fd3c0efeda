"""A diagnosis in words: first what to do, no figure that says nothing, long lists only when asked for."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcompass.gap import diagnose_gap
from mavcompass.gap.result import Cause, Closing, Diagnosis, Flight, Place, Verdict
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.report.gap_words import (
    _closing,
    _places,
    advice,
    cause_values,
    figures_of,
    shrink_words,
    summary,
)
from mavcompass.simulation import effects
from mavcompass.simulation.effects import get


@pytest.fixture(scope="module")
def magnet() -> Diagnosis:
    return diagnose_gap(
        make_track(Recipe("figure-8", duration_s=40.0, seed=51), [effects.parse("hard_iron:x=-30,y=20,z=12")])
    )


def test_the_first_line_says_what_to_do(magnet: Diagnosis) -> None:
    first, *rest = summary(magnet)
    assert first == "Calibrate: the vehicle's iron is not what its parameters say."
    assert " %), permanent magnetism fixed to the vehicle: x -" in "\n".join(rest)


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("no_gap", "No problem found"),
        ("named_with_remainder", "Then record and diagnose again"),
        ("ambiguous", "record this to decide: spins"),
        ("unknown", "--baseline"),
        ("not_testable", "Record again, with turns"),
    ],
)
def test_every_verdict_has_its_advice(magnet: Diagnosis, verdict: Verdict, words: str) -> None:
    spins = Flight("spins", ("hard_iron", "soft_iron"), 12.0)
    assert words in advice(replace(magnet, verdict=verdict, next_flight=(spins,)))


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (
            [("hard_iron",), ("soft_iron",)],
            "Calibrate: the vehicle's iron is not what its parameters say; which",
        ),
        ([("hard_iron",), ("motor_current",)], "Change nothing yet: other causes"),
    ],
)
def test_causes_with_one_remedy_need_not_be_told_apart(
    magnet: Diagnosis, sets: list[tuple[str, ...]], words: str
) -> None:
    alike = tuple((ids, 0.5) for ids in sets)
    torn = replace(magnet, verdict="ambiguous", ambiguity_set=alike, next_flight=())
    assert words in advice(torn)
    assert f"  instead it may be: {sets[1][0]}" in summary(torn)


def test_readings_that_come_late_are_no_silence(magnet: Diagnosis) -> None:
    late = replace(magnet, verdict="no_gap", late_s=0.31)
    assert advice(late).startswith("Look at the compass's driver") and "0.31 s old" in advice(late)


def test_a_coarse_recording_does_not_vouch_for_the_heading(magnet: Diagnosis) -> None:
    coarse = replace(magnet, verdict="no_gap", heading=Closing(4.8, 4.8, 12.8, 0.0, (0.0, 0.0)))
    assert "No problem found; errors under 13 deg would be invisible." in advice(coarse)


@pytest.mark.parametrize(
    ("after", "shrink", "interval", "words"),
    [
        (1.0, 0.999, (0.998, 1.0), "100 %"),
        (1.0, 0.96, (0.92, 0.98), "96 % (92 to 98)"),
        (9.0, 1.3, (-0.2, 1.6), "100 % (0 to 100, uncertain)"),
        (9.0, 0.5, (float("nan"), float("nan")), "50 % (too short for an interval)"),
        (10.0, 0.0, (0.0, 0.0), "none"),
    ],
)
def test_a_share_is_said_with_its_interval_where_that_says_more(
    after: float, shrink: float, interval: tuple[float, float], words: str
) -> None:
    assert shrink_words(Closing(10.0, after, 1.0, shrink, interval)) == words


def test_what_belongs_to_the_model_alone_is_not_shown() -> None:
    def cause(effect: str, **parameters: float) -> Cause:
        given = {p.name: p.default for p in get(effect).parameters} | parameters
        return Cause(effect, given, {name: (v, v + 1.0) for name, v in given.items()}, 0.9, ())

    step = cause("hard_iron_step", on_s=30.0)
    assert "from 30 s" in cause_values(step) and "until" not in cause_values(step), "it stays on for good"
    assert not any("e+" in value or "iron" in name for name, value, _, _ in figures_of(step))
    turned = cause("inclination", angle_rad=0.1)
    assert figures_of(turned) == [("angle", "5.73", "5.73 to 63", "deg")]
    assert "on iron" not in cause_values(cause("misalignment"))


def test_a_gap_is_told_as_it_is_and_as_it_would_be() -> None:
    said = _closing("heading", Closing(39.5, 0.6, 0.5, 1.0, (1.0, 1.0)), "deg")
    assert (
        said == "  heading: 39.5 deg now; 0.6 once corrected (100 % of the gap; 0.5 is the recording's noise)"
    )


def test_what_is_not_told_apart_is_named_together() -> None:
    places = [
        Place("mag_x", "axis", 0.6, ""),
        Place("heading", "time", 0.86, ""),
        Place("heading", "temperature", 0.84, ""),
        Place("heading", "tilt", 0.3, ""),
    ]
    assert _places(places) == "mostly depends on time or temperature (86 %), most on the compass's x"


def test_what_could_not_show_is_counted_and_listed_only_when_asked_for(magnet: Diagnosis) -> None:
    assert magnet.not_testable
    effect, why = magnet.not_testable[0]
    assert f"{len(magnet.not_testable)} possible causes cannot be tested" in summary(magnet)[-1]
    assert why not in "\n".join(summary(magnet))
    hidden = replace(magnet, not_testable=(("hard_iron", "its estimator learns it"),))
    assert not any("cannot be tested: its" in line for line in summary(hidden))  # it is named
    told = summary(replace(hidden, verdict="no_gap", causes=()))
    assert "  iron on the vehicle (hard_iron) cannot be tested: its estimator learns it" in told
    listed = next(line for line in summary(magnet, everything=True) if why in line)
    assert effect in listed
