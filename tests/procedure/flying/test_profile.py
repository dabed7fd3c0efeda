"""The motion that is taken out of a recording, against motions that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.procedure.flying import Profile, profile_of
from mavcompass.track import MagSeries, Series, Track

TIME = np.arange(400.0) * 0.05
METRES_PER_DEG = 111_195.0


def recording(yaw_rad: FloatArray | float = 0.5, vehicle: str = "rover", **more: Any) -> Track:
    yaw = np.broadcast_to(yaw_rad, TIME.shape)
    values: dict[str, Any] = {
        "compasses": {1: MagSeries(1, Series.of(TIME, np.full((400, 3), 200.0)))},
        "attitude_rad": Series.of(
            TIME, np.stack([0.0 * TIME, 0.0 * TIME, np.mod(yaw, 2.0 * math.pi)], axis=1)
        ),
        **more,
    }
    return Track(vehicle=vehicle, **values)


def series(*columns: FloatArray | float) -> Series:
    return Series.of(TIME, np.stack([np.broadcast_to(c, TIME.shape) for c in columns], axis=1))


def test_the_yaw_is_unwrapped_and_smooth() -> None:
    profile = profile_of(recording(0.5 * TIME))
    assert profile.time_s[:3].tolist() == [0.0, 0.1, 0.2] and profile.duration_s == pytest.approx(19.9)
    middle = slice(4, -4)
    assert profile.yaw_rad[middle] == pytest.approx(0.5 * profile.time_s[middle])
    assert profile.yaw_rate_radps[middle] == pytest.approx(np.full(profile.time_s.size - 8, 0.5))
    assert profile.rate_hz == pytest.approx(20.0) and profile.utc_s is None and profile.kind == "rover"
    jump = profile_of(recording(np.where(TIME < 10.0, 0.0, 0.1)))  # of an estimator: no turn of 1 rad/s
    assert jump.yaw_rate_radps.max() == pytest.approx(0.1 / 0.5)


def test_an_independent_attitude_is_believed_first() -> None:
    half = 0.5 * 0.3 * TIME
    reference = series(np.cos(half), 0.0, 0.0, np.sin(half))
    profile = profile_of(recording(0.0, reference_q=reference))
    assert profile.yaw_rate_radps[10] == pytest.approx(0.3)
    one = Series.of(TIME[:1], np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert profile_of(recording(0.2 * TIME, reference_q=one)).yaw_rate_radps[10] == pytest.approx(0.2)


def test_the_motion_begins_with_both_and_ends_with_the_first() -> None:
    late = MagSeries(1, Series.of(TIME[60:], np.full((340, 3), 200.0)))
    early = Series.of(TIME[:300], np.stack([0.0 * TIME, 0.0 * TIME, 0.1 * TIME], axis=1)[:300])
    track = Track(compasses={1: late}, attitude_rad=early, gps_velocity_mps=series(TIME, 0.0, 0.0))
    profile = profile_of(replace(track, vehicle="boat", utc_offset_s=1000.0))
    assert profile.velocity_mps[20, 0] == pytest.approx(5.0)
    assert profile.utc_s == 1003.0 and profile.duration_s == pytest.approx(14.95 - 3.0, abs=0.1)
    assert profile.yaw_rad[20] == pytest.approx(0.1 * 5.0)
    assert profile_of(recording(), longest_s=10.0).duration_s == pytest.approx(9.9)


@pytest.mark.parametrize(("longest_s", "is_enough"), [(9.99, False), (10.0, True)])
def test_ten_seconds_are_worth_while(longest_s: float, is_enough: bool) -> None:
    if is_enough:
        assert profile_of(recording(), longest_s=longest_s).duration_s > 9.0
    else:
        with pytest.raises(BadRecording, match="10 s with attitude and compass"):
            profile_of(recording(), longest_s=longest_s)


@pytest.mark.parametrize(("readings", "lasts"), [(1, None), (2, "has 0 s with attitude and compass")])
def test_one_reading_is_no_motion(readings: int, lasts: str | None) -> None:
    compass = MagSeries(1, Series.of(TIME[:readings], np.full((readings, 3), 200.0)))
    attitude = recording().attitude_rad
    assert attitude is not None
    short = Series.of(attitude.time_s[:readings], attitude.values[:readings])
    for track, lacking in (
        (recording(compasses={1: compass}), "compass 1"),
        (recording(attitude_rad=short), "attitude"),
    ):
        with pytest.raises(BadRecording, match=lasts or f"tells no {lacking}"):
            profile_of(track)


def test_the_speed_along_the_nose_is_the_velocitys_share() -> None:
    velocity = series(3.0, 4.0, -1.0)
    for yaw, forward in ((0.0, 3.0), (0.5 * math.pi, 4.0), (math.pi, -3.0), (math.atan2(4.0, 3.0), 5.0)):
        profile = profile_of(recording(yaw, gps_velocity_mps=velocity))
        assert profile.forward_mps == pytest.approx(np.full(profile.time_s.size, forward))
    assert not profile_of(recording()).forward_mps.any()
    assert not profile_of(recording(gps_velocity_mps=Series.of([], np.empty((0, 3))))).velocity_mps.any()


@pytest.mark.parametrize(
    ("deg_s", "mps", "seconds", "pivots"),
    [
        (6.1, 0.14, 3.6, True), (5.9, 0.14, 3.6, False), (6.1, 0.16, 3.6, False), (6.1, -0.14, 3.6, True),
        (-6.1, 0.0, 3.6, True), (20.0, 0.0, 2.6, False),
    ],
)  # fmt: skip
def test_three_seconds_of_turning_on_the_spot_are_a_pivot(
    deg_s: float, mps: float, seconds: float, pivots: bool
) -> None:
    time = np.arange(0.0, 20.0, 0.1)
    rate = np.where(time < seconds - 0.3, math.radians(deg_s), 0.0)
    velocity = np.stack([np.full(200, mps), np.zeros(200), np.zeros(200)], axis=1)
    profile = Profile("rover", time, np.zeros(200), rate, velocity, np.zeros((200, 3)), None, 20.0, None)
    assert profile.pivots is pivots


def test_the_index_of_a_time_is_the_nearest() -> None:
    profile = profile_of(recording())
    assert [profile.at(t) for t in (-5.0, 0.0, 0.04, 0.06, 1.0, 1e9)] == [0, 0, 0, 1, 10, 199]


def test_where_nothing_tells_the_place_the_velocity_is_summed_up() -> None:
    profile = profile_of(recording(gps_velocity_mps=series(2.0, -1.0, 0.5)))
    assert profile.position_m[-1, :2] == pytest.approx([40.0, -20.0], abs=0.3) and profile.home is None
    assert profile.position_m[:, 2].max() == pytest.approx(-2.0)  # its lowest place is above the ground
    assert np.diff(profile.position_m[:, 2]) == pytest.approx(np.full(199, 0.05))


def test_what_the_autopilot_says_of_its_place_is_taken() -> None:
    local = series(TIME, 2.0 * TIME, -5.0)
    place = series(47.0 + 10.0 / METRES_PER_DEG, 8.0 + 20.0 / METRES_PER_DEG, 505.0)
    profile = profile_of(recording(vehicle="copter", position_ned_m=local, place=place))
    assert profile.position_m[10] == pytest.approx([1.0, 2.0, -5.0])
    assert profile.home == pytest.approx((47.0 + 10.0 / METRES_PER_DEG, 8.0 + 20.0 / METRES_PER_DEG, 500.0))
    away = series(100.0 + 0.0 * TIME, -50.0, -5.0)
    there = profile_of(recording(position_ned_m=away, place=place)).home
    assert there is not None
    shrunk = METRES_PER_DEG * math.cos(math.radians(47.0 + 10.0 / METRES_PER_DEG))
    assert there[0] == pytest.approx(47.0 - 90.0 / METRES_PER_DEG)
    assert there[1] == pytest.approx(8.0 + 20.0 / METRES_PER_DEG + 50.0 / shrunk)


def test_a_place_on_the_globe_is_turned_into_metres() -> None:
    north, east, high = 3.0 * TIME, -2.0 * TIME, 500.0 + TIME
    lat = 60.0 + north / METRES_PER_DEG
    place = series(lat, 8.0 + east / (0.5 * METRES_PER_DEG), high)
    profile = profile_of(recording(vehicle="copter", place=place))
    metres = np.stack([3.0 * profile.time_s, -2.0 * profile.time_s, -2.0 - profile.time_s], axis=1)
    assert profile.position_m == pytest.approx(metres, abs=1e-3)
    assert profile.home == pytest.approx((60.0, 8.0, 498.0))


@pytest.mark.parametrize(("vehicle", "down_m"), [("copter", -2.0), ("rover", -0.5)])
def test_a_copter_is_asked_for_no_height_at_which_it_would_land(vehicle: str, down_m: float) -> None:
    profile = profile_of(recording(vehicle=vehicle, position_ned_m=series(0.0, 0.0, -0.5)))
    assert profile.position_m[:, 2] == pytest.approx(np.full(200, down_m))
