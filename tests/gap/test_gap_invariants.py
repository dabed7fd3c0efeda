"""What holds of every diagnosis, whatever was made: figures and words agree."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from mavcompass.gap import Diagnosis, diagnose, diagnose_gap
from mavcompass.gap.answer.description import Evidence, describe
from mavcompass.gap.answer.verdict import Answer
from mavcompass.gap.trial.cases import Motion, Recipe, ideal, make_track, stimulus_of, to_track
from mavcompass.gap.trial.vehicles.cases import Tier, VehicleCase, make_case
from mavcompass.simulation import effects
from mavcompass.track import Track

ABOVE = 1.3
CAUSES = (
    "",
    "hard_iron:x=40,y=-25",
    "soft_iron:xx=0.05,xy=0.03",
    "bias_random_walk:sigma_mgauss_per_sqrt_s=1.5",
)
MADE: list[tuple[Motion, str, bool]] = [
    *(("figure-8", text, True) for text in CAUSES),
    *(("yaw-steps", text, False) for text in CAUSES),
    ("figure-8", "", False),
    ("figure-8", "hard_iron:x=40,y=-25", False),
    ("yaw-steps", "", True),
    ("yaw-steps", "soft_iron:xx=0.05,xy=0.03", True),
    ("rich", "", False),
    ("rich", "motor_current:x=1.5,y=-1", True),
]
# Small seeds whose recordings are short.
VEHICLES: list[tuple[Tier, int]] = [("none", 2), ("none", 3), ("none", 8), ("single", 7), ("outside", 6)]


@dataclass(frozen=True)
class Said:
    """Hold a diagnosis, and what it was made from."""

    diagnosis: Diagnosis
    evidence: Evidence


def diagnosed(track: Track, baseline: Track | None, monkeypatch: pytest.MonkeyPatch) -> Said:
    seen: list[Evidence] = []

    def listening(evidence: Evidence, answer: Answer) -> Diagnosis:
        seen.append(evidence)
        return describe(evidence, answer)

    monkeypatch.setattr(diagnose, "describe", listening)
    diagnosis = diagnose_gap(track, baseline)
    (evidence,) = seen
    return Said(diagnosis, evidence)


def check(said: Said) -> None:
    """Assert what figures and words must agree about."""
    diagnosis, floor = said.diagnosis, said.evidence.floor
    both = (diagnosis.field, diagnosis.heading)
    turns = bool(said.evidence.replay.present & {"turning", "tilt"})
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


@lru_cache(maxsize=8)
def good(motion: Motion) -> Track:
    return make_track(Recipe(motion, duration_s=40.0, rate_hz=10.0, seed=22))


@lru_cache(maxsize=8)
def case(tier: Tier, seed: int) -> VehicleCase:
    return make_case(seed, tier)


@pytest.mark.parametrize(("motion", "text", "with_baseline"), MADE)
def test_made_case_is_told_without_contradiction(
    motion: Motion, text: str, with_baseline: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = [effects.parse(text)] if text else []
    track = make_track(Recipe(motion, duration_s=40.0, rate_hz=10.0, seed=21), settings)
    said = diagnosed(track, good(motion) if with_baseline else None, monkeypatch)
    check(said)
    if not text:
        assert said.diagnosis.verdict == "no_gap"


@pytest.mark.parametrize("with_baseline", [True, False])
@pytest.mark.parametrize(("tier", "seed"), VEHICLES)
def test_vehicle_is_told_without_contradiction(
    tier: Tier, seed: int, with_baseline: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = case(tier, seed)
    said = diagnosed(made.track, made.baseline if with_baseline else None, monkeypatch)
    check(said)
    if tier == "none" and with_baseline:
        assert said.diagnosis.verdict == "no_gap"


@pytest.mark.parametrize("offset_mgauss", [0.0, 150.0])
def test_vehicle_that_stands_still_is_not_testable(
    offset_mgauss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    said = diagnosed(
        to_track(still, replace(reading, mag_mgauss=reading.mag_mgauss + offset_mgauss + noise)),
        None,
        monkeypatch,
    )
    check(said)
    assert said.diagnosis.verdict == "not_testable"
