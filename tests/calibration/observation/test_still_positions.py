"""Where a recording stands still, and how it is cut into positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import (
    Dwell,
    assemble,
    find_dwells,
    observe,
    turn_record,
    turns_between,
)
from mavcompass.calibration.observation.stillness import (
    _centred_mean,
    _cut_from_turn,
    _spread,
    _standing,
    _steady_current,
    _still_windows,
)
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track

DEG = math.radians(1.0)
TIME = np.arange(1001.0) * 0.02
STILL = np.zeros(TIME.size)


def record(
    deg_s: FloatArray, tilt_deg_s: FloatArray = STILL, noise_deg_s: float = 0.0, time: FloatArray = TIME
) -> TurnRecord:
    rate = DEG * deg_s
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    return TurnRecord(time, angle, rate, DEG * tilt_deg_s, 0.0, 0.0, DEG * noise_deg_s, 0.0, 0.02)


def windows(turn: TurnRecord) -> list[tuple[float, float]]:
    return [(round(a, 2), round(b, 2)) for a, b in _still_windows(turn)]


def between(start_s: float, end_s: float, value: float) -> FloatArray:
    return np.where((TIME > start_s - 0.001) & (TIME < end_s - 0.001), value, 0.0)


def test_a_vehicle_that_stands_is_one_position_from_end_to_end() -> None:
    assert windows(record(STILL)) == [(0.0, 20.0)]


def test_a_turn_divides_two_positions_and_the_second_settles() -> None:
    # At 30 deg/s a tenth of the half second that is averaged over makes 3 deg/s.
    assert windows(record(between(8.0, 11.0, 30.0))) == [(0.0, 7.8), (11.45, 20.0)]
    assert windows(record(between(8.0, 11.0, -30.0))) == [(0.0, 7.8), (11.45, 20.0)]


@pytest.mark.parametrize(("deg_s", "is_still"), [(2.9, True), (-2.9, True), (3.1, False), (-3.1, False)])
def test_three_degrees_a_second_is_still(deg_s: float, is_still: bool) -> None:
    assert len(windows(record(between(8.0, 11.0, deg_s)))) == (1 if is_still else 2)


@pytest.mark.parametrize(
    ("tilt_deg_s", "noise_deg_s", "is_still"),
    [(5.9, 0.0, True), (6.1, 0.0, False), (8.5, 2.0, True), (8.7, 2.0, False)],
)
def test_six_degrees_a_second_of_tilting_is_still_and_noise_beside_it(
    tilt_deg_s: float, noise_deg_s: float, is_still: bool
) -> None:
    found = windows(record(STILL, between(8.0, 11.0, tilt_deg_s), noise_deg_s))
    assert len(found) == (1 if is_still else 2)


def test_a_creep_of_fourteen_degrees_makes_another_position() -> None:
    # After 14 degrees at 2 deg/s, each time: and what begins after a turn has a quarter of a second less.
    assert windows(record(STILL + 2.0)) == [(0.0, 7.02), (7.27, 14.02), (14.27, 20.0)]
    assert windows(record(STILL - 2.0)) == windows(record(STILL + 2.0))
    to_and_fro = record(np.where(TIME % 10.0 < 5.0, 2.0, -2.0))
    assert windows(to_and_fro) == [(0.0, 20.0)]  # ten degrees and back


@pytest.mark.parametrize(("stands_s", "count"), [(1.6, 2), (1.7, 3)])
def test_a_second_of_standing_is_a_position(stands_s: float, count: int) -> None:
    rate = between(8.0, 9.0, 30.0) + between(9.0 + stands_s, 12.0, 30.0)
    assert len(windows(record(rate))) == count


def test_what_rolls_is_cut_out() -> None:
    rolling = np.zeros(TIME.size, dtype=bool)
    assert _standing(TIME, rolling, (2.0, 9.0)) == [(2.0, 9.0)]
    rolling[(TIME > 3.001) & (TIME < 4.001)] = True
    assert [(round(a, 2), round(b, 2)) for a, b in _standing(TIME, rolling, (1.5, 9.0))] == [
        (1.5, 3.0),
        (4.02, 8.98),
    ]
    assert len(_standing(TIME, rolling, (2.5, 9.0))) == 1  # half a second before it is none
    assert _standing(TIME, rolling, (5.0, 9.0)) == [(5.0, 9.0)]
    rolling[:] = True
    assert _standing(TIME, rolling, (2.0, 9.0)) == []


def loaded(amperes: FloatArray, window: tuple[float, float] = (0.0, 20.0)) -> list[tuple[float, float]]:
    track = Track(current_a=Series.of(TIME, amperes))
    return [(round(a, 2), round(b, 2)) for a, b in _steady_current(track, window)]


@pytest.mark.parametrize(("amperes", "count"), [(3.9, 1), (4.0, 1), (4.1, 2), (-4.0, 1), (-4.1, 2)])
def test_a_load_that_jumps_by_four_amperes_divides(amperes: float, count: int) -> None:
    assert len(loaded(10.0 + between(8.0, 30.0, amperes))) == count


@pytest.mark.parametrize(("amperes", "count"), [(9.9, 1), (10.0, 1), (10.1, 2)])
def test_or_by_a_quarter(amperes: float, count: int) -> None:
    assert len(loaded(40.0 + between(8.0, 30.0, amperes))) == count


def test_the_parts_of_a_load_meet_and_last_a_second() -> None:
    assert loaded(between(8.0, 30.0, 20.0)) == [(0.0, 8.0), (8.0, 20.0)]
    assert loaded(between(8.0, 8.9, 20.0)) == [(0.0, 8.0), (8.9, 20.0)]
    assert loaded(between(8.0, 9.1, 20.0)) == [(0.0, 8.0), (8.0, 9.1), (9.1, 20.0)]
    assert loaded(between(8.0, 30.0, 20.0), (8.5, 9.4)) == []
    assert loaded(between(8.0, 30.0, 20.0), (7.0, 12.5)) == [(7.0, 8.0), (8.0, 12.5)]
    # A load that grows slowly is held against the median of what came before.
    assert loaded(TIME) == [(0.0, 8.0), (8.0, 16.0), (16.0, 20.0)]


def test_a_load_that_nobody_knows_divides_nothing() -> None:
    assert _steady_current(Track(), (0.0, 20.0)) == [(0.0, 20.0)]
    assert loaded(np.where(TIME > 5.0, np.nan, 0.0)) == [(0.0, 20.0)]
    assert loaded(between(8.0, 30.0, 20.0), (7.97, 8.01)) == [(7.97, 8.01)]  # two readings


def test_the_mean_is_of_what_is_near_in_time() -> None:
    uneven = np.array([0.0, 0.1, 0.2, 5.0, 5.25, 5.5])
    values = np.array([1.0, 2.0, 6.0, 0.0, 3.0, 9.0])
    assert _centred_mean(uneven, values).tolist() == [3.0, 3.0, 3.0, 1.5, 4.0, 6.0]


def test_windows_reach_over_the_circle_less_its_largest_empty_arc() -> None:
    turn = record(STILL + 10.0)  # 200 degrees in 20 s
    assert _spread(turn, []) == 0.0
    assert math.degrees(_spread(turn, [(0.0, 2.0)])) == pytest.approx(0.0)
    assert math.degrees(_spread(turn, [(0.0, 2.0), (8.0, 10.0), (18.0, 20.0)])) == pytest.approx(180.0)
    twice = record(STILL + 36.0)  # all the way round: the beginning is near the end
    assert math.degrees(_spread(twice, [(0.0, 0.0), (2.5, 2.5), (9.0, 9.0)])) == pytest.approx(126.0)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_four_positions_are_cut_out_of_a_turn(sense: float) -> None:
    compass_time = np.arange(201.0) * 0.1
    cut = _cut_from_turn(record(STILL + sense * 20.5), compass_time)  # 410 degrees
    middles = [20.5 * 0.5 * (a + b) for a, b in cut]
    assert middles == pytest.approx([20.0, 110.0, 200.0, 290.0, 380.0], abs=0.5)
    assert [20.5 * (b - a) for a, b in cut] == pytest.approx([40.0] * 5, abs=0.5)
    # Only while there is a compass, and only where there are four readings.
    assert len(_cut_from_turn(record(STILL + sense * 20.5), compass_time[:111])) == 3
    assert len(_cut_from_turn(record(STILL + sense * 20.5), compass_time[::5])) == 5
    assert _cut_from_turn(record(STILL + sense * 20.5), compass_time[::7]) == []


@pytest.mark.parametrize(("deg_s", "is_turn"), [(9.9, False), (10.1, True), (-9.9, False), (-10.1, True)])
def test_two_hundred_degrees_are_a_turn(deg_s: float, is_turn: bool) -> None:
    assert bool(_cut_from_turn(record(STILL + deg_s), TIME)) is is_turn
    assert _cut_from_turn(record(STILL + deg_s), TIME[:1]) == []


def recorded(deg_s: FloatArray, vehicle: str = "unknown", **more: Any) -> Track:
    """Make a level recording of a good compass that turns at a rate, (N,), deg/s."""
    rate = DEG * deg_s
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.02)])
    field = np.stack([200.0 * np.cos(angle), -200.0 * np.sin(angle), np.full(TIME.size, 400.0)], axis=1)
    field += np.random.default_rng(1).normal(0.0, 0.5, field.shape)
    rates = np.stack([0.0 * rate, 0.0 * rate, rate], axis=1)
    return Track(
        source="made up",
        autopilot="px4",
        vehicle=vehicle,
        compasses={1: MagSeries(1, Series.of(TIME[::5], field[::5]))},
        gyro_radps=Series.of(TIME, rates),
        **more,
    )


FOUR = between(3.0, 5.0, 45.0) + between(8.0, 10.0, 45.0) + between(13.0, 15.0, 45.0)


def test_four_positions_and_the_turns_between_them() -> None:
    data = observe(recorded(FOUR))
    assert data.source == "made up" and len(data.dwells) == 4
    assert [d.start_s for d in data.dwells] == pytest.approx([0.0, 5.4, 10.4, 15.4], abs=0.11)
    assert [d.end_s for d in data.dwells] == pytest.approx([2.7, 7.7, 12.7, 20.0], abs=0.11)
    assert np.degrees([s.angle_rad for s in data.steps]) == pytest.approx([90.0] * 3, abs=0.1)
    middles = [0.5 * (d.start_s + d.end_s) for d in data.dwells]
    assert [s.duration_s for s in data.steps] == pytest.approx(np.diff(middles))
    assert data.gyro_scale_sigma == 0.01 and data.tilt_bias_sigma_rad == pytest.approx(0.001, rel=0.15)
    record = turn_record(recorded(FOUR))
    assert record is not None and data.gyro_bias_sigma_radps == record.bias_sigma_radps


def test_a_turn_is_as_sure_as_its_gyro_and_both_ends() -> None:
    track = recorded(FOUR)
    turn = record(FOUR)
    plain: dict[str, Any] = {"mean_mgauss": np.zeros(3), "covariance_mgauss2": np.eye(3)}
    first = Dwell(0.0, 2.0, **plain, turned_sigma_rad=0.03)
    second = Dwell(6.0, 7.0, **plain, turned_sigma_rad=0.04)
    (step,) = turns_between(track, [first, second], 1, turn)
    gyro = turn.independent_sigma_rad(2.0, 6.0)
    assert step.sigma_rad == pytest.approx(math.sqrt(0.05**2 + gyro**2)) and gyro > 0.0
    assert math.degrees(step.angle_rad) == pytest.approx(90.0, abs=1e-6) and step.duration_s == 5.5


def test_a_position_that_swings_has_its_mean_angle() -> None:
    track = recorded(np.where(TIME < 2.0, 2.0, np.where(TIME < 4.0, -4.0, 0.0)))
    plain: dict[str, Any] = {"mean_mgauss": np.zeros(3), "covariance_mgauss2": np.eye(3)}
    dwells = [Dwell(0.0, 2.0, **plain), Dwell(6.0, 7.0, **plain)]
    (step,) = turns_between(track, dwells)
    # From 0 to 4 degrees on the average 2; afterwards it stands at -4.
    assert math.degrees(step.angle_rad) == pytest.approx(-6.0, abs=0.1)


def test_a_take_off_divides_a_position() -> None:
    current = Series.of(TIME, np.where(TIME < 17.5, 0.0, 20.0))
    assert len(find_dwells(recorded(FOUR, current_a=current))) == 5


def test_a_turn_that_never_stands_is_cut() -> None:
    track = recorded(STILL + 20.5)  # 410 degrees
    found = find_dwells(track)
    assert len(found) == 5
    assert [math.degrees(d.turned_rad) for d in found] == pytest.approx([20, 110, 200, 290, 380], abs=2.0)


@pytest.mark.parametrize(("degrees", "is_cut"), [(147.0, True), (153.0, False)])
def test_standing_on_both_sides_of_150_degrees_is_no_turn_to_be_cut(degrees: float, is_cut: bool) -> None:
    rate = between(4.0, 8.0, degrees / 4.0) + between(12.0, 16.0, (360.0 - degrees) / 4.0)
    assert any(d.turned_sigma_rad > 0.01 for d in find_dwells(recorded(rate))) is is_cut


def test_where_nothing_turns_it_says_so() -> None:
    with pytest.raises(PoorCalibration, match="changed by only 80 degrees in all"):
        observe(recorded(between(3.0, 5.0, 40.0)))
    with pytest.raises(PoorCalibration, match="no gyro, so neither stillness"):
        find_dwells(Track(compasses=recorded(FOUR).compasses))
    with pytest.raises(PoorCalibration, match="no gyro, so the turned angles"):
        turns_between(Track(compasses=recorded(FOUR).compasses), [])
    with pytest.raises(KeyError):
        find_dwells(recorded(FOUR), 2)
    nothing = assemble(Track(source="x"), [])
    assert not nothing.dwells and nothing.gyro_bias_sigma_radps == 0.0


def test_positions_without_four_readings_are_none() -> None:
    track = recorded(FOUR)
    compass = track.compasses[1].reported
    late = MagSeries(1, Series.of(compass.time_s[30:], compass.values[30:]))
    found = find_dwells(Track(compasses={1: late}, gyro_radps=track.gyro_radps, autopilot="px4"))
    assert len(found) == 3
