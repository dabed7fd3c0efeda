"""A clock is told by when its readings come, however the messages fall beside it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mavcompass.gap.replay.rows import reading_times


def _brought(period_s: float, message_s: float, phase_s: float, length_s: float = 90.0) -> tuple:
    """Let messages bring the last reading; return when new ones came, and when they were taken."""
    messages = np.arange(phase_s, length_s, message_s)
    tick = np.floor(messages / period_s)
    # Of the first message nobody knows how old its reading is.
    new = np.concatenate([[False], np.diff(tick) > 0.0])
    return messages[new], tick[new] * period_s


@pytest.mark.parametrize("period_s", [0.0981, 0.1, 0.1037])
@pytest.mark.parametrize("message_s", [0.0199, 0.0253, 0.0302, 0.0399, 0.0561, 0.0672, 0.0793])
def test_readings_are_put_back_on_the_clock_they_were_taken_by(period_s: float, message_s: float) -> None:
    came, taken = _brought(period_s, message_s, 0.031)
    age = reading_times(came, message_s, np.zeros(came.size, dtype=np.bool_)) - taken
    assert age.std() <= max(0.003, 0.35 * (came - taken).std())
    assert abs(age.mean() - (came - taken).mean()) < 0.2 * message_s


@settings(max_examples=40, deadline=None)
@given(period=st.floats(0.095, 0.105), message=st.floats(0.015, 0.08), phase=st.floats(0.0, 0.1))
def test_no_step_of_the_messages_makes_the_times_worse(period: float, message: float, phase: float) -> None:
    # Messages very nearly twice as often as readings fit two clocks.
    assume(abs(2.0 * message / period - 1.0) > 0.02)
    came, taken = _brought(period, message, phase)
    age = reading_times(came, message, np.zeros(came.size, dtype=np.bool_)) - taken
    assert age.std() <= 1.02 * (came - taken).std() + 0.001


def test_lost_messages_and_a_clock_that_drifts_leave_the_readings_on_it() -> None:
    came, taken = _brought(0.1, 0.04, 0.013, 400.0)
    # A clock that gains a millisecond in ten seconds goes on being one.
    came, taken = came * 1.0001, taken * 1.0001
    rng = np.random.default_rng(5)
    heard = rng.random(came.size) > 0.2
    heard[1000:1100] = False
    age = reading_times(came[heard], 0.04, np.zeros(came[heard].size, dtype=np.bool_)) - taken[heard]
    assert (came - taken).std() > 0.008
    assert age.std() < 0.002


def test_the_first_reading_after_a_loss_keeps_its_time() -> None:
    came, _ = _brought(0.1, 0.04, 0.003, 100.0)
    lost = np.zeros(came.size, dtype=np.bool_)
    lost[[300, 500]] = True
    read = reading_times(came, 0.04, lost)
    assert np.array_equal(read[lost], came[lost]) and (read[~lost] != came[~lost]).mean() > 0.9


@pytest.mark.parametrize("scatter_s", [0.03, 0.1])
def test_what_follows_no_clock_keeps_its_times(scatter_s: float) -> None:
    rng = np.random.default_rng(6)
    came = np.cumsum(0.1 + scatter_s * rng.random(800))
    assert np.array_equal(reading_times(came, 0.02, np.zeros(came.size, dtype=np.bool_)), came)


def test_a_handful_of_readings_tells_no_clock() -> None:
    came, _ = _brought(0.1, 0.04, 0.0, 5.0)
    assert np.array_equal(reading_times(came, 0.04, np.zeros(came.size, dtype=np.bool_)), came)


def test_messages_as_often_as_readings_tell_no_clock_but_their_own() -> None:
    rng = np.random.default_rng(8)
    came = np.arange(0.0, 400.0, 0.1) + 0.001 * rng.standard_normal(4000)
    # A sensor that stays now and then brings something new in some of them.
    new = came[rng.random(came.size) > 0.3]
    assert np.array_equal(reading_times(new, 0.1, np.zeros(new.size, dtype=np.bool_)), new)
