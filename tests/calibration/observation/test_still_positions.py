"""Where a recording stands still, and how it is cut into positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import (
    assemble,
    dwell_between,
    find_dwells,
    observe,
    turn_record,
    turns_between,
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


def between(start_s: float, end_s: float, value: float) -> FloatArray:
    return np.where((TIME > start_s - 0.001) & (TIME < end_s - 0.001), value, 0.0)


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


def test_a_position_that_swings_has_its_mean_angle() -> None:
    track = recorded(np.where(TIME < 2.0, 2.0, np.where(TIME < 4.0, -4.0, 0.0)))
    dwells = [dwell_between(track, 1, 0.0, 2.0), dwell_between(track, 1, 6.0, 7.0)]
    (step,) = turns_between(track, dwells)
    # From 0 to 4 degrees on the average 2; afterwards it stands at -4.
    assert math.degrees(step.angle_rad) == pytest.approx(-6.0, abs=0.1)


def test_a_take_off_divides_a_position() -> None:
    current = Series.of(TIME, np.where(TIME < 17.5, 0.0, 20.0))
    assert len(find_dwells(recorded(FOUR, current_a=current))) == 5
    nobody_knows = Series.of(TIME, np.where(TIME < 17.5, 0.0, np.nan))
    assert len(find_dwells(recorded(FOUR, current_a=nobody_knows))) == 4


def test_a_turn_that_never_stands_is_cut() -> None:
    track = recorded(STILL + 20.5)  # 410 degrees
    found = find_dwells(track)
    assert len(found) == 5
    assert [math.degrees(d.turned_rad) for d in found] == pytest.approx([20, 110, 200, 290, 380], abs=2.0)


def test_where_nothing_turns_it_says_so() -> None:
    with pytest.raises(PoorCalibration, match="changed by only 80 degrees in all"):
        observe(recorded(between(3.0, 5.0, 40.0)))
    with pytest.raises(PoorCalibration, match="no gyro, so neither stillness"):
        find_dwells(Track(compasses=recorded(FOUR).compasses))
    with pytest.raises(PoorCalibration, match="no gyro, so neither stillness"):
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
