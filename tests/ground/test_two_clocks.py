"""Two autopilots that speak with one system id, told by their clocks."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.two_clocks import TwoClocks

TIME_S = np.arange(0.0, 30.0, 0.25)


def seen(*boot_s: float, goes_on: bool = False) -> bool:
    """Hear times one by one and all at once: both must say the same."""
    one, all_at_once = TwoClocks(), TwoClocks()
    for time_s in boot_s:
        one.hear("ATTITUDE", time_s, goes_on)
    all_at_once.hear_all("ATTITUDE", np.array(boot_s))
    assert goes_on or one.seen is all_at_once.seen
    return one.seen


def turns(apart_s: float, lost: float, seed: int = 1) -> list[float]:
    """Let two be heard in turns, some of it lost."""
    chance = np.random.default_rng(seed)
    both = [(t, t + start_s) for t in TIME_S for start_s in (100.0, 100.0 + apart_s)]
    return [float(boot_s + 0.1 * chance.random()) for _, boot_s in both if chance.random() >= lost]


@pytest.mark.parametrize("apart_s", [1.5, 5.0, 500.0, -40.0])
@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_two_in_turns_are_seen(apart_s: float, lost: float) -> None:
    assert seen(*turns(apart_s, lost))


def test_two_fast_streams_are_seen() -> None:
    assert seen(*(float(t + start_s) for t in np.arange(0.0, 8.0, 0.02) for start_s in (100.0, 600.0)))


def test_who_numbers_on_is_one_whatever_his_clock_says() -> None:
    assert not seen(*turns(40.0, 0.0), goes_on=True)


@pytest.mark.parametrize(
    "boot_s",
    [
        TIME_S,
        np.concatenate([TIME_S + 500.0, TIME_S]),  # restarted
        np.concatenate([TIME_S + 500.0, TIME_S, TIME_S, TIME_S, TIME_S]),  # again and again
        np.where(np.arange(TIME_S.size) % 20 == 7, 2.0**32 * np.sin(TIME_S), TIME_S),  # damaged
        np.repeat([3.0, 9.0], 60),
        np.concatenate([t + np.arange(8)[::-1] * 0.4 for t in TIME_S[::16]]),  # the last sent comes first
    ],
)
def test_one_clock_is_one_through_restarts_damage_and_late_bursts(boot_s: np.ndarray) -> None:
    assert not seen(*boot_s.tolist())


@pytest.mark.parametrize("apart_s", [0.0, 0.8])
def test_clocks_as_near_as_a_link_delays_are_not_told_apart(apart_s: float) -> None:
    assert not seen(*turns(apart_s, 0.0))
