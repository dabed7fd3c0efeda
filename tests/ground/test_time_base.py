"""A track's clock is one that its samples bear out, whatever time stamps say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.track_builder import with_sound_times

HOUR_S = 3600.0


def track(times: np.ndarray, **columns: Series) -> Track:
    field = Series.of(times, np.ones((times.size, 3)))
    steps = (InForce(-np.inf, IDENTITY), InForce(float(times[-1]), FieldCorrection((5.0, 0.0, 0.0))))
    return Track(compasses={1: MagSeries(1, field, steps)}, **columns)  # type: ignore[arg-type]


def test_a_recording_as_they_are_is_left_alone() -> None:
    """An hour between two flights, or a day in which something came every second."""
    for times in (np.r_[0:300:0.1, 3000:3300:0.1], np.arange(86_400.0), np.array([5.0])):
        one = track(times)
        assert with_sound_times(one) is one


@pytest.mark.parametrize("leap_s", [1e4, 1e9, 1e17, 1e300])
@pytest.mark.parametrize("where", [0, 500, 999])
def test_one_time_that_leaps_costs_an_hour_at_most(leap_s: float, where: int) -> None:
    times = 20.0 + 0.1 * np.arange(1000)
    times[where] += leap_s
    sound = with_sound_times(track(np.sort(times)))
    compass = sound.compasses[1]
    span_s = compass.time_s[-1] - compass.time_s[0]
    assert span_s == pytest.approx(HOUR_S)
    # All others are where they were, to the step of such numbers.
    assert np.count_nonzero(np.isin(compass.time_s.round(6), times.round(6))) == 999
    assert compass.in_force[1].from_s == pytest.approx(compass.time_s[-1])
    assert "1 silences were shortened" in sound.notes[-1]


@given(st.lists(st.floats(1.0, 1e9), min_size=2, max_size=40))
def test_silences_are_shortened_to_one_length_as_far_as_it_takes(silences: list[float]) -> None:
    times = np.concatenate([[0.0], np.cumsum(silences)])
    kept = np.diff(with_sound_times(track(times)).compasses[1].time_s)
    step = 1e-3  # of numbers as large as these, with room
    assert kept.sum() <= HOUR_S + step
    shortened = kept < np.diff(times) - step
    if times[-1] > HOUR_S + 40 * step:
        assert shortened.any() and kept.sum() == pytest.approx(HOUR_S)
        assert np.ptp(kept[shortened]) < step and kept.max() < kept[shortened].max() + step
    else:
        assert not shortened.any()


def test_all_columns_move_together() -> None:
    times = np.r_[0:100:0.1, 1e9 : 1e9 + 100 : 0.1]
    attitude = Series.of(times[::5], np.zeros((times[::5].size, 3)))
    sound = with_sound_times(track(times, attitude_rad=attitude))
    assert sound.attitude_rad is not None
    np.testing.assert_allclose(sound.attitude_rad.time_s, sound.compasses[1].time_s[::5])


@pytest.mark.parametrize("step_s", [0.0, 1e-9, 1e-6])
def test_what_has_no_clock_is_left_out_and_told(step_s: float) -> None:
    still = Series.of(20.0 + step_s * np.arange(100), np.zeros(100))
    sound = with_sound_times(track(0.1 * np.arange(100), throttle=still))
    assert sound.throttle is None and list(sound.compasses) == [1]
    assert sound.notes[-1].startswith("Left out throttle: ")
    assert not with_sound_times(track(still.time_s)).compasses
