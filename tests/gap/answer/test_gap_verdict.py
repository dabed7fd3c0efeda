"""What is said, by how probable the best set is and by what is left."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcompass.gap.answer.decision import Findings, verdict
from mavcompass.gap.result import Verdict
from mavcompass.gap.tables import Outcome

SURE = 0.9
NOTHING: dict[Outcome, float] = {"whole": 0.25, "part": 0.25, "other": 0.25, "unknown": 0.25}
SILENT = Findings(silent=True, left=False, outcomes=NOTHING, shared=False, testable=True)


def likely(whole: float = 0.0, part: float = 0.0, other: float = 0.0) -> dict[Outcome, float]:
    return {"whole": whole, "part": part, "other": other, "unknown": 1.0 - whole - part - other}


def found(outcomes: dict[Outcome, float]) -> Findings:
    return replace(SILENT, silent=False, outcomes=outcomes)


def test_where_nothing_is_found_silence_needs_what_healthy_vehicles_leave() -> None:
    assert verdict(SILENT, SURE) == "no_gap"
    assert verdict(replace(SILENT, left=True), SURE) == "unknown"
    still = replace(SILENT, testable=False)
    assert verdict(still, SURE) == "not_testable"
    assert verdict(replace(still, left=True), SURE) == "unknown", "what varies is a gap all the same"
    assert verdict(found(likely(whole=0.95)), SURE) == "named"


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
    assert verdict(found(outcomes), SURE) == said


def test_what_the_catalogue_is_not_alone_to_make_is_not_sure() -> None:
    assert verdict(replace(found(likely(whole=0.99)), shared=True), SURE) == "ambiguous"


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (likely(whole=0.99), "named_with_remainder"),
        (likely(whole=0.6, other=0.3), "named_with_remainder"),
        (likely(whole=0.45, other=0.5), "unknown"),
    ],
)
def test_what_healthy_vehicles_do_not_leave_is_left(outcomes: dict[Outcome, float], said: Verdict) -> None:
    assert verdict(replace(found(outcomes), left=True), SURE) == said
