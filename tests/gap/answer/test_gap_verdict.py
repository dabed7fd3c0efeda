"""What is said, by how probable the best set is and by two p values."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcompass.gap.answer.decision import Findings, verdict
from mavcompass.gap.result import Verdict
from mavcompass.gap.tables import Levels, Outcome

LEVELS = Levels(gain=0.01, fit=0.02, sure=0.9, above=1.3, held=0.9, coarsest_deg=15.0)
NOTHING: dict[Outcome, float] = {"whole": 0.25, "part": 0.25, "other": 0.25, "unknown": 0.25}
SILENT = Findings(False, False, True, 1.0, 0.5, NOTHING, shared=False, above=False, testable=True)


def likely(whole: float = 0.0, part: float = 0.0, other: float = 0.0) -> dict[Outcome, float]:
    return {"whole": whole, "part": part, "other": other, "unknown": 1.0 - whole - part - other}


def found(outcomes: dict[Outcome, float]) -> Findings:
    return replace(SILENT, found=True, searched=True, p_gain=0.001, outcomes=outcomes)


def test_where_nothing_is_found_silence_needs_what_healthy_vehicles_leave() -> None:
    assert verdict(SILENT, LEVELS) == "no_gap"
    assert verdict(replace(SILENT, p_fit=0.02), LEVELS) == "unknown"
    assert verdict(replace(SILENT, above=True), LEVELS) == "unknown"
    still = replace(SILENT, testable=False)
    assert verdict(still, LEVELS) == "not_testable"
    assert verdict(replace(still, p_fit=0.001), LEVELS) == "unknown", "what varies is a gap all the same"


def test_a_set_that_gains_what_healthy_vehicles_do_is_no_finding() -> None:
    sure = found(likely(whole=0.95))
    assert verdict(sure, LEVELS) == "named"
    by_chance = replace(sure, p_gain=0.011)
    assert verdict(by_chance, LEVELS) == "no_gap"
    assert verdict(replace(sure, confirmed=False), LEVELS) == "no_gap"
    # What single readings show is no set of a search.
    assert verdict(replace(by_chance, searched=False), LEVELS) == "named"


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (likely(whole=0.9), "named"),
        (likely(whole=0.89), "ambiguous"),
        (likely(whole=0.5, other=0.4), "ambiguous"),
        (likely(other=0.6), "ambiguous"),
        (likely(whole=0.3, part=0.6), "named_with_remainder"),
        (likely(whole=0.4), "unknown"),
        (likely(), "unknown"),
    ],
)
def test_the_likeliest_of_four_outcomes_is_said(outcomes: dict[Outcome, float], said: Verdict) -> None:
    assert verdict(found(outcomes), LEVELS) == said


def test_what_the_catalogue_is_not_alone_to_make_is_not_sure() -> None:
    assert verdict(replace(found(likely(whole=0.99)), shared=True), LEVELS) == "ambiguous"


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (likely(whole=0.99), "named_with_remainder"),
        (likely(whole=0.6, other=0.3), "named_with_remainder"),
        (likely(whole=0.45, other=0.5), "unknown"),
    ],
)
def test_what_healthy_vehicles_do_not_leave_is_left(outcomes: dict[Outcome, float], said: Verdict) -> None:
    assert verdict(replace(found(outcomes), above=True), LEVELS) == said
    assert verdict(replace(found(outcomes), p_fit=0.02), LEVELS) == said
