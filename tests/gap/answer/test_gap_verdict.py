"""What is said, by how probable the best set is and by what is left."""

from __future__ import annotations

from functools import partial

import pytest

from mavcompass.gap.answer.decision import verdict
from mavcompass.gap.result import Verdict
from mavcompass.gap.tables import Outcome

NOTHING: dict[Outcome, float] = {"whole": 0.25, "part": 0.25, "other": 0.25, "unknown": 0.25}
found = partial(verdict, sure=0.9, silent=False, left=False, shared=False, testable=True)
silent = partial(found, NOTHING, silent=True)


def likely(whole: float = 0.0, part: float = 0.0, other: float = 0.0) -> dict[Outcome, float]:
    return {"whole": whole, "part": part, "other": other, "unknown": 1.0 - whole - part - other}


def test_where_nothing_is_found_silence_needs_what_healthy_vehicles_leave() -> None:
    assert silent() == "no_gap"
    assert silent(left=True) == "unknown"
    assert silent(testable=False) == "not_testable"
    assert silent(testable=False, left=True) == "unknown", "what varies is a gap all the same"
    assert found(likely(whole=0.95)) == "named"


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
    assert found(outcomes) == said


def test_what_the_catalogue_is_not_alone_to_make_is_not_sure() -> None:
    assert found(likely(whole=0.99), shared=True) == "ambiguous"


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (likely(whole=0.99), "named_with_remainder"),
        (likely(whole=0.6, other=0.3), "named_with_remainder"),
        (likely(whole=0.45, other=0.5), "unknown"),
    ],
)
def test_what_healthy_vehicles_do_not_leave_is_left(outcomes: dict[Outcome, float], said: Verdict) -> None:
    assert found(outcomes, left=True) == said
