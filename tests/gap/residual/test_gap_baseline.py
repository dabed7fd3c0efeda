"""What a baseline tells of the next recording, and how far two recordings of one vehicle differ."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.replay.rows import reading_times
from mavcompass.gap.residual.baseline import _waiting_s
from mavcompass.gap.residual.floor import heading_error_rad, heading_scatter, rms
from mavcompass.gap.trial.vehicles import make_case

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


@pytest.mark.parametrize("seed", [41, 304241175])
def test_a_heading_scatters_as_readings_do_behind_their_calibration(seed: int) -> None:
    here = replay(make_case(seed, "none").track)
    field, rng = here.measured.mag_mgauss, np.random.default_rng(seed)
    told = 0.5 * rms(heading_scatter(here, field))
    drawn = [
        rms(heading_error_rad(here, field + 0.5 * rng.standard_normal(field.shape), field)) for _ in range(20)
    ]
    assert told == pytest.approx(float(np.mean(drawn)), rel=0.03)
