"""What holds of every diagnosis, whatever was made: figures and words agree."""

from __future__ import annotations

import math

import pytest

from mavcompass.gap import Diagnosis
from mavcompass.gap.answer.evidence import Evidence

ABOVE = 1.3


def check(diagnosis: Diagnosis, evidence: Evidence) -> None:
    """Assert what figures and words must agree about."""
    floor = evidence.floor
    both = (diagnosis.field, diagnosis.heading)
    turns = bool(evidence.replay.present & {"turning", "tilt"})
    silent = diagnosis.verdict in ("no_gap", "not_testable")
    if silent and turns:
        assert all(c.nominal <= ABOVE * c.floor for c in both)
    if not turns and not floor.measured:
        assert diagnosis.verdict != "no_gap"
    if diagnosis.verdict == "named" and not floor.representative:
        assert all(c.after <= ABOVE * c.floor for c in both)
    if diagnosis.verdict == "named":
        assert diagnosis.causes and not diagnosis.unknown
    if silent or diagnosis.verdict == "unknown":
        # Nothing is fitted then, and only an unknown cause is flagged.
        assert not diagnosis.waterfall and diagnosis.unknown != silent
    for closing in both:
        numbers = (closing.nominal, closing.after, closing.floor, closing.shrink, *closing.shrink_ci95)
        assert all(math.isfinite(x) for x in numbers)
        assert closing.after <= closing.nominal + 1e-9 and closing.floor > 0.0
        assert closing.shrink_ci95[0] <= closing.shrink_ci95[1]
        if not floor.measured:
            assert max(closing.shrink, *closing.shrink_ci95) <= 1.0 + 1e-9
    for cause in (*diagnosis.causes, *diagnosis.look_alikes):
        assert all(math.isfinite(x) for x in cause.parameters.values())
        assert all(low <= high for low, high in cause.ci95.values())
        assert all(math.isfinite(x) for ends in cause.ci95.values() for x in ends)
        assert 0.0 <= cause.probability <= 1.0 + 1e-9
    # What is said of the sets is a probability: they are exclusive, and something unknown has the rest.
    assert sum(weight for _, weight in diagnosis.ambiguity_set) <= 1.0 + 1e-9
    for cause in diagnosis.causes:
        held = sum(weight for ids, weight in diagnosis.ambiguity_set if cause.effect in ids)
        assert cause.probability == pytest.approx(held, abs=1e-9)
    if diagnosis.verdict == "named" and len(diagnosis.causes) == len(diagnosis.waterfall) == 1:
        # It removes what the gap closes by, on the same held-out parts; what only scatters removes nothing.
        closed = math.sqrt(diagnosis.field.nominal**2 - diagnosis.field.after**2)
        assert diagnosis.causes[0].removes_mgauss == pytest.approx(closed, rel=0.01)
