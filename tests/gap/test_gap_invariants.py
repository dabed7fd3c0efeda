"""Vehicles are told without a contradiction; conftest.py checks each diagnosis that these tests make."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from agreement import check

from mavcompass.gap import diagnose, diagnose_gap
from mavcompass.gap.answer.decision import Answer
from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.trial.cases import Recipe, make_track, stimulus_of, to_track
from mavcompass.gap.trial.vehicles.cases import Tier, VehicleCase, make_case
from mavcompass.simulation.physics.signals import ideal

# Small seeds whose recordings are short.
VEHICLES: list[tuple[Tier, int]] = [("none", 11), ("outside", 9)]


@lru_cache(maxsize=8)
def case(tier: Tier, seed: int) -> VehicleCase:
    return make_case(seed, tier)


@pytest.mark.parametrize("with_baseline", [True, False])
@pytest.mark.parametrize(("tier", "seed"), VEHICLES)
def test_vehicle_is_told_without_contradiction(tier: Tier, seed: int, with_baseline: bool) -> None:
    made = case(tier, seed)
    diagnosis = diagnose_gap(made.track, made.baseline if with_baseline else None)
    if tier == "none" and with_baseline:
        assert diagnosis.verdict == "no_gap"


@pytest.mark.parametrize("offset_mgauss", [0.0, 150.0])
def test_vehicle_that_stands_still_is_not_testable(offset_mgauss: float) -> None:
    stimulus = stimulus_of(Recipe("rich", duration_s=40.0, rate_hz=10.0, seed=21))
    rotation = np.repeat(stimulus.rotation[:1], stimulus.time_s.size, axis=0)
    still = replace(
        stimulus,
        rotation=rotation,
        rate_radps=np.zeros_like(stimulus.rate_radps),
        specific_force_mps2=rotation[:, 2] * -9.80665,
    )
    reading = ideal(still)
    noise = 3.0 * np.random.default_rng(8).standard_normal(reading.mag_mgauss.shape)
    moved = replace(reading, mag_mgauss=reading.mag_mgauss + offset_mgauss + noise)
    diagnosis = diagnose_gap(to_track(still, moved))
    assert diagnosis.verdict == "not_testable"
    assert any("hardly turns" in note for note in diagnosis.notes)


def test_a_contradiction_ends_the_test_that_made_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of all these tests is in force, and sees a verdict that its figures do not bear out."""

    def boasting(evidence: Evidence, answer: Answer) -> object:
        diagnosis = describe(evidence, replace(answer, verdict="named"))
        check(diagnosis, evidence)
        return diagnosis

    assert diagnose.describe is not describe
    monkeypatch.setattr(diagnose, "describe", boasting)
    with pytest.raises(AssertionError):
        diagnose_gap(make_track(Recipe("figure-8", duration_s=40.0, rate_hz=10.0, seed=22)))
