"""What whole numbers hide of an average, held against readings that are made and converted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation.wire import fresh_readings, unquantise, white_noise
from mavcompass.frames import FloatArray

CHANCE = np.random.default_rng(11)
# Averages at every place in a step, and readings about them.
PLACES = 20.0 + (np.arange(200) + 0.5) / 200.0
READINGS = CHANCE.normal(size=(400, 200))
TIME = np.arange(1201.0) * 0.02  # 24 s


def converted(noise: float, truncated: bool, quantum: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return how far averages come out from what they were, (200,), and what is said to be hidden."""
    steps = PLACES + noise * READINGS
    told = quantum * (np.trunc(steps) if truncated else np.round(steps))
    spread = np.sqrt((told.std(axis=0) ** 2).mean()) * np.ones(200)
    value, hidden = unquantise(told.mean(axis=0), spread, quantum, truncated)
    return value / quantum - PLACES, hidden / quantum


@pytest.mark.parametrize("truncated", [True, False])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.6, 2.0])
def test_what_is_hidden_is_how_far_averages_come_out(noise: float, truncated: bool) -> None:
    off, hidden = converted(noise, truncated)
    chance = (noise**2 + 1.0 / 12.0) / 400.0  # of the mean of 400 readings
    assert np.mean(off**2) == pytest.approx(hidden[0] ** 2 + (chance if noise else 0.0), rel=0.15, abs=2e-4)
    assert np.mean(off) == pytest.approx(0.0, abs=0.03)
    assert converted(noise, truncated, 4.0)[1] == pytest.approx(hidden)


def test_without_steps_nothing_is_hidden() -> None:
    value, hidden = unquantise([1.5, -2.0], [0.1, 0.1], 0.0, True)
    assert value.tolist() == [1.5, -2.0] and hidden.tolist() == [0.0, 0.0]


def test_the_cell_about_zero_is_twice_as_wide() -> None:
    value, hidden = unquantise([0.0, 1.0, -1.0, -7.0], np.zeros(4), 2.0, True)
    assert value == pytest.approx(
        [0.0, 1.0 + 0.5 * 2.0 * math.erf(0.85 * math.sqrt(2.0)), -1.9, -8.0], abs=0.1
    )
    # Half a step from zero it may be either.
    assert hidden == pytest.approx(2.0 * np.array([2.0, 1.0, 1.0, 1.0]) / math.sqrt(12.0), rel=1e-6)
    rounded, about = unquantise([0.0], [0.0], 2.0, False)
    assert rounded[0] == 0.0 and about[0] == pytest.approx(2.0 / math.sqrt(12.0))


def test_near_zero_noise_is_cut_both_ways() -> None:
    for average in (0.1, 0.4, -0.7, 1.2):
        told = np.trunc(average + 2.0 * READINGS)
        value, _ = unquantise([told.mean()], [told.std()], 1.0, True)
        assert value[0] == pytest.approx(average, abs=0.06)
        assert abs(told.mean()) < abs(value[0])


def test_fresh_is_what_differs_from_the_reading_before() -> None:
    readings = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 3.0], [0.0, 3.0], [0.0, 3.0]])
    assert fresh_readings(readings).tolist() == [True, False, True, True, False]
    assert [fresh_readings(readings[:n]).tolist() for n in (0, 1, 2)] == [[], [True], [True, False]]


def test_white_noise_is_seen_beside_smooth_motion() -> None:
    chance = np.random.default_rng(5)
    values = (
        chance.normal(size=(4000, 3)) * [1.0, 2.0, 0.0] + 30.0 * np.sin(TIME[:1000].repeat(4))[:, None] * 0.1
    )
    time = 0.04 * np.arange(4000)
    assert white_noise(time, values)[:2] == pytest.approx([1.0, 2.0], rel=0.06)
    assert white_noise(time, values, quantile=0.25)[:2] == pytest.approx([1.0, 2.0], rel=0.08)
    assert white_noise(TIME, np.outer(TIME, [1.0, 2.0, 3.0])) == pytest.approx(np.full(3, 1e-9), abs=1e-9)


def test_noise_behind_a_filter_adds_up_as_it_did_before_it() -> None:
    white = np.random.default_rng(5).normal(size=(20_000, 1))
    filtered = (white[:-3] + white[1:-2] + white[2:-1] + white[3:]) / 4.0
    time = 0.004 * np.arange(len(filtered))
    assert white_noise(time, filtered) == pytest.approx([1.0], rel=0.2)
    # Neighbours alone show a third of it.
    assert white_noise(10.0 * time, filtered) < 0.4
