"""What is said, by how probable the best set is and by what is left."""

from __future__ import annotations

import pytest

from mavcompass.gap.answer.decision import verdict
from mavcompass.gap.result import Verdict
from mavcompass.gap.tables import Outcome


def likely(whole: float = 0.0, part: float = 0.0, other: float = 0.0) -> dict[Outcome, float]:
    return {"whole": whole, "part": part, "other": other, "unknown": 1.0 - whole - part - other}


SILENT, LEFT, SHARED, UNTESTABLE = {"silent": True}, {"left": True}, {"shared": True}, {"testable": False}


@pytest.mark.parametrize(
    ("outcomes", "seen", "said"),
    [
        # Where nothing is found silence needs what healthy vehicles leave; what varies is a gap all the same.
        (likely(0.25, 0.25, 0.25), SILENT, "no_gap"),
        (likely(0.25, 0.25, 0.25), SILENT | LEFT, "unknown"),
        (likely(0.25, 0.25, 0.25), SILENT | UNTESTABLE, "not_testable"),
        (likely(0.25, 0.25, 0.25), SILENT | UNTESTABLE | LEFT, "unknown"),
        # The likeliest of four outcomes is said.
        (likely(whole=0.9), {}, "named"),
        (likely(whole=0.89), {}, "ambiguous"),
        (likely(whole=0.5, other=0.4), {}, "ambiguous"),
        (likely(other=0.6), {}, "ambiguous"),
        (likely(whole=0.3, part=0.6), {}, "named_with_remainder"),
        (likely(whole=0.4), {}, "unknown"),
        (likely(), {}, "unknown"),
        # What the catalogue is not alone to make is not sure, and what healthy vehicles do not leave is left.
        (likely(whole=0.99), SHARED, "ambiguous"),
        (likely(whole=0.99), LEFT, "named_with_remainder"),
        (likely(whole=0.6, other=0.3), LEFT, "named_with_remainder"),
        (likely(whole=0.45, other=0.5), LEFT, "unknown"),
    ],
)
def test_what_is_said(outcomes: dict[Outcome, float], seen: dict[str, bool], said: Verdict) -> None:
    told = {"silent": False, "left": False, "shared": False, "testable": True} | seen
    assert verdict(outcomes, 0.9, **told) == said
