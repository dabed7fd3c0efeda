"""A magnet that comes to a vehicle: when, and how strong."""

from __future__ import annotations

import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles import make_case


def test_step_stays_where_it_was_found_though_the_rows_about_it_are_set_aside() -> None:
    case = make_case(2116634633, "single")
    (_, truth), *_ = case.effects
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict == "named"
    (cause,) = found.causes
    assert cause.effect == "hard_iron_step"
    assert cause.parameters["on_s"] == pytest.approx(truth["on_s"], abs=0.2)
    assert [cause.parameters[axis] for axis in "xyz"] == pytest.approx(
        [truth[axis] for axis in "xyz"], abs=1.0
    )
