"""What a baseline tells of the next recording, and how far two recordings of one vehicle differ."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.replay.rows import reading_times
from mavcompass.gap.residual.baseline import _waiting_s
from mavcompass.gap.residual.floor import (
    STATED,
    first_noise,
    heading_error_rad,
    heading_scatter,
    prior_of,
    rms,
)
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.simulation.effects import parse
from mavcompass.track import Series, Track

PERIOD_S, SPAN_S = 0.1, 120.0


def reported(step_s: float, rng: np.random.Generator, lost: float, traced: bool) -> tuple[Any, float]:
    """Read a compass ten times a second and report it with messages that begin anywhere: what a replay traces
    of it, where that is wanted, and how long readings waited for their message on the average."""
    message_s = rng.uniform(0.0, step_s) + np.arange(0.0, SPAN_S, step_s)
    message_s = message_s[rng.random(message_s.size) >= lost]
    reading = np.floor((message_s - 1e-9) / PERIOD_S)
    first = np.flatnonzero(np.diff(reading, prepend=-1.0) > 0.0)
    last = np.append(first[1:], message_s.size) - 1
    logged_s = message_s + 2e-4 * rng.standard_normal(message_s.size)
    waited_s = float(np.mean(message_s[first] - PERIOD_S * reading[first]))
    if not traced:
        return None, waited_s
    trace = SimpleNamespace(fresh_s=logged_s[first], held_s=logged_s[last] - logged_s[first])
    after_loss = np.diff(message_s, prepend=message_s[0])[first] > 1.5 * step_s
    oftener = first.size < 0.9 * message_s.size
    read_s = reading_times(trace.fresh_s, step_s, after_loss) if oftener else trace.fresh_s
    return SimpleNamespace(trace=trace, readings=SimpleNamespace(time_s=read_s)), waited_s


@pytest.mark.parametrize(
    ("step_s", "phases_s", "lost"),
    [
        (0.02, 0.02, 0.02),  # in step: the phase of the start stays
        (0.05, 0.05, 0.0),
        (0.1, 0.1, 0.02),
        (0.04, 0.02, 0.02),  # every other message is: two phases, a half of the step apart
        (0.08, 0.02, 0.0),  # every fifth
        (0.0397, 0.0, 0.02),  # they drift through each other
    ],
)
def test_how_long_readings_wait_differs_by_what_does_not_occur_in_one_recording(
    step_s: float, phases_s: float, lost: float
) -> None:
    rng = np.random.default_rng(5)
    drawn = [reported(step_s, rng, lost, traced=k < 20) for k in range(200)]
    told = np.array([_waiting_s(replay) for replay, _ in drawn[:20]])
    assert np.mean(np.abs(told - phases_s / math.sqrt(6.0)) < 0.004) >= 0.9
    between_starts = math.sqrt(2.0) * float(np.std([waited for _, waited in drawn]))
    assert float(np.median(told)) == pytest.approx(between_starts, rel=0.15, abs=0.004)


def test_few_readings_tell_nothing_of_how_they_wait() -> None:
    few: Any = SimpleNamespace(
        trace=SimpleNamespace(fresh_s=np.arange(5.0), held_s=np.zeros(5)),
        readings=SimpleNamespace(time_s=np.arange(5.0)),
    )
    assert _waiting_s(few) == 0.0


def test_a_field_of_the_motors_that_a_baseline_flew_with_is_no_gap_at_another_load() -> None:
    def flown(seed: int, more_a: float) -> Track:
        track = make_track(Recipe(duration_s=60.0, seed=seed), [parse("motor_current:x=2,y=-1.5,z=1")])
        assert track.current_a is not None
        compass, current = track.compasses[1], track.current_a
        raw = compass.reported.values + more_a * np.array([2.0, -1.5, 1.0])
        compass = replace(compass, reported=Series.of(compass.time_s, raw))
        more = Series.of(current.time_s, current.values + more_a)
        return replace(track, compasses={1: compass}, current_a=more)

    assert diagnose_gap(flown(1, 12.0), flown(2, 0.0)).verdict == "no_gap"


@pytest.mark.parametrize("seed", [41, 304241175])
def test_a_heading_scatters_as_readings_do_behind_their_calibration(seed: int) -> None:
    here = replay(make_case(seed, "none").track)
    field, rng = here.measured.mag_mgauss, np.random.default_rng(seed)
    told = 0.5 * rms(heading_scatter(here, field))
    drawn = [
        rms(heading_error_rad(here, field + 0.5 * rng.standard_normal(field.shape), field)) for _ in range(20)
    ]
    assert told == pytest.approx(float(np.mean(drawn)), rel=0.03)


@pytest.mark.parametrize("about", [[0, 1, 2], [3, 5, 8], list(range(6))])
def test_what_readings_tell_beside_what_was_known_is_what_a_fit_leaves(about: list[int]) -> None:
    """Of some parameters, all others integrated out: the marginal of the posterior, without their prior."""
    seen = replay(make_case(4, "none", baseline=False).track)
    problem = Problem(seen, first_noise(seen), seen.valid, prior_of(seen, STATED))
    fit = problem.fit(problem.null(), 50)
    told, toward = problem.information(fit, np.array(about))
    known = problem.prior.precision[np.ix_(about, about)]
    covariance = np.linalg.inv(told + known)
    assert covariance == pytest.approx(fit.covariance[np.ix_(about, about)], rel=1e-3, abs=1e-9)
    sigma = np.sqrt(np.diag(covariance))
    values = covariance @ (toward + known @ problem.prior.mean[about])
    assert ((values - fit.nuisances[about]) / sigma) == pytest.approx(np.zeros(len(about)), abs=0.05)


@pytest.mark.parametrize("seed", [947012, 947020, 947026, 947061, 947064])
def test_a_healthy_vehicle_whose_attitude_somebody_measured_is_silent(seed: int) -> None:
    """Its sensors are off by what is usual, and readings wait for their messages in another way."""
    case = make_case(seed, "none")
    flight, baseline = (
        replace(one, reference_q=one.truth_q) for one in (case.track, case.baseline) if one is not None
    )
    assert diagnose_gap(flight, baseline).verdict == "no_gap"
