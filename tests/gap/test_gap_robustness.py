"""What other people's recordings taught: slow compasses, coarse numbers, level turns, no baseline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcompass.gap import Diagnosis, diagnose_gap
from mavcompass.gap.replay.noise import SensorNoise, wandering
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.simulation import effects
from mavcompass.track import MagSeries, Series, Track

RICH = Recipe("rich", duration_s=45.0, rate_hz=10.0, seed=51)
LEVEL = Recipe("yaw-steps", duration_s=60.0, rate_hz=10.0, seed=53)


@pytest.fixture(scope="module")
def baseline() -> Track:
    return make_track(replace(RICH, seed=52))


def diagnose(text: str, recipe: Recipe, baseline: Track | None) -> Diagnosis:
    return diagnose_gap(make_track(recipe, [effects.parse(t) for t in text.split("+") if t]), baseline)


def with_field(track: Track, field: np.ndarray) -> Track:
    return replace(track, compasses={1: MagSeries(1, Series.of(track.compasses[1].time_s, field))})


def test_white_scatter_on_a_slow_error_is_whitened() -> None:
    rng = np.random.default_rng(4)
    n, rho, slow, scatter = 40_000, 0.99, 2.0, np.array([3.0, 2.7, 2.4])
    sigma, moving = wandering(scatter, slow, rho)
    noise = SensorNoise(
        np.full((1, 3), rho), sigma, np.hypot(scatter, slow), np.inf, moving=np.full(3, moving)
    )
    drift = np.zeros((n, 3))
    steps = slow * np.sqrt(1.0 - rho**2) * rng.standard_normal((n, 3))
    for i in range(1, n):
        drift[i] = rho * drift[i - 1] + steps[i]
    z = noise.whiten(drift + scatter * rng.standard_normal((n, 3)))[100:]
    np.testing.assert_allclose(z.std(axis=0), 1.0, rtol=0.03)
    assert np.abs(np.mean(z[1:] * z[:-1], axis=0)).max() < 0.04


def test_constant_offset_is_found_behind_loud_scatter_without_a_baseline() -> None:
    diagnosis = diagnose("hard_iron:x=14,y=-9,z=6", replace(RICH, rate_hz=50.0), None)
    assert diagnosis.effects == {"hard_iron"} and diagnosis.verdict in ("named", "ambiguous")
    assert diagnosis.causes[0].parameters["x"] == pytest.approx(14.0, abs=1.5)


@pytest.mark.parametrize("every", [2, 5])
def test_compass_that_is_read_more_slowly_than_it_is_logged_is_healthy(every: int) -> None:
    track = make_track(replace(RICH, rate_hz=10.0 * every))
    field = track.compasses[1].reported.values
    held = with_field(track, field[np.arange(len(field)) // every * every])
    replayed = replay(held)
    assert replayed.telemetry and len(replayed.time_s) == len(field) // every
    diagnosis = diagnose_gap(held)
    assert diagnosis.verdict == "no_gap"
    assert {"stale_samples", "transport_lag"} <= {name for name, _ in diagnosis.not_testable}


def test_whole_milligauss_are_no_fault() -> None:
    track = make_track(LEVEL)
    whole = with_field(track, np.trunc(track.compasses[1].reported.values))
    assert diagnose_gap(whole).verdict == "no_gap"


@pytest.mark.parametrize("recipe", [LEVEL, RICH], ids=lambda r: r.motion)
def test_steps_far_coarser_than_the_noise_are_named_alone(recipe: Recipe) -> None:
    diagnosis = diagnose("quantisation:step_mgauss=12", recipe, make_track(replace(recipe, seed=99)))
    assert diagnosis.effects == {"quantisation"} and diagnosis.verdict == "named"


def test_noise_does_not_look_like_causes(baseline: Track) -> None:
    diagnosis = diagnose("noise_excess:sigma_mgauss=12+hard_iron:x=30,y=-20", RICH, baseline)
    assert diagnosis.effects == {"noise_excess", "hard_iron"} and diagnosis.verdict == "named"
    sizes = {c.effect: c.parameters for c in diagnosis.causes}
    assert sizes["noise_excess"]["sigma_mgauss"] == pytest.approx(12.0, rel=0.1)


def test_scatter_beyond_any_data_sheet_is_named_without_a_baseline() -> None:
    diagnosis = diagnose("noise_excess:sigma_mgauss=18", RICH, None)
    assert diagnosis.effects == {"noise_excess"}
    assert diagnosis.field.floor < 8.0 < diagnosis.field.nominal


def test_small_faults_of_the_world_are_told_from_what_the_model_does_not_know(baseline: Track) -> None:
    """Declination is an eastward field, which is solved for; the baseline says how little there is."""
    diagnosis = diagnose("declination:angle_rad=0.01", RICH, baseline)
    assert diagnosis.effects == {"declination"}
    assert diagnosis.causes[0].parameters["angle_rad"] == pytest.approx(0.01, abs=0.003)


def test_level_turns_never_make_sure_of_what_needs_tilt() -> None:
    diagnosis = diagnose("soft_iron:xx=0.08,yy=-0.06,xy=0.1,xz=-0.05", LEVEL, None)
    assert diagnosis.verdict == "ambiguous" and diagnosis.effects == {"soft_iron"}
    assert "soft_iron" in dict(diagnosis.not_testable)
    assert diagnosis.field.shrink > 0.9


def test_turns_that_are_misjudged_by_a_tenth_are_named(baseline: Track) -> None:
    diagnosis = diagnose("yaw_step_error:fraction=0.12", LEVEL, None)
    assert "yaw_step_error" in diagnosis.effects
    assert diagnosis.field.after < 0.1 * diagnosis.field.nominal


def test_reference_temperature_stays_near_the_recording(baseline: Track) -> None:
    """Far from the recorded temperatures it would only be a hard iron by another name."""
    diagnosis = diagnose(
        "hard_iron:x=120,y=80,z=-60+temperature_bias:x=0.4,y=-0.3,reference_degc=30", RICH, None
    )
    assert "hard_iron" in diagnosis.effects
