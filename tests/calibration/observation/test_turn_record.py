"""The turned angle by the gyro: what it is, what is not known of it, and where the bias is found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track

DEG = math.radians(1.0)
TIME = np.arange(0.0, 10.01, 0.25)


def record(rate_radps: FloatArray, time: FloatArray = TIME, walk_rad: float = 0.0) -> TurnRecord:
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate_radps[1:] + rate_radps[:-1]) * np.diff(time))])
    return TurnRecord(time, angle, rate_radps, 0.0 * time, 0.0, 0.0, 0.0, walk_rad, 0.25)


def gyro_of(rates: FloatArray, time: FloatArray = TIME, **more: Any) -> Track:
    return Track(gyro_radps=Series.of(time, rates), **more)


def test_a_rate_that_bends_between_samples_is_less_certain() -> None:
    # rate = t^2: each trapezoid of 1/4 s misses h^3/12 * 2, and so do eight of them, independently.
    sigma = record(TIME**2).independent_sigma_rad(2.1, 4.1)
    assert sigma == pytest.approx(math.sqrt(8.0) * 0.25**3 / 6.0)
    assert record(3.0 * TIME).independent_sigma_rad(2.1, 4.1) == pytest.approx(0.0, abs=1e-12)


def test_a_turn_in_a_gap_lies_within_what_is_not_known() -> None:
    # Twelve turns by 20 degrees in 1.5 s and one of them unheard: it stands still at both ends of the gap.
    time = np.arange(0.0, 96.0, 0.04)
    rate = math.radians(20.0 / 0.75) * np.clip(1.0 - np.abs(time % 8.0 - 4.0) / 0.75, 0.0, None)
    heard = np.abs(time - 44.0) > 1.0
    sigma = record(rate[heard], time[heard]).independent_sigma_rad(40.0, 48.0)
    assert math.radians(20.0) / 3.0 < sigma < math.radians(20.0)
    assert record(0.0 * rate[heard], time[heard]).independent_sigma_rad(40.0, 48.0) == 0.0


def test_the_angle_is_the_integral_of_the_rate_about_the_vertical() -> None:
    rates = np.stack([0.3 + 0.0 * TIME, 0.4 + 0.0 * TIME, 0.5 * np.sin(TIME)], axis=1)
    turn = turn_record(gyro_of(rates))
    assert turn is not None
    assert turn.angle_rad == pytest.approx(0.5 - 0.5 * np.cos(TIME), abs=0.006)
    assert turn.rate_radps == pytest.approx(rates[:, 2])
    assert turn.tilt_rate_radps == pytest.approx(np.full(TIME.size, 0.5))
    assert turn.interval_s == 0.25 and turn.bias_radps == 0.0


def test_of_a_leaning_vehicle_the_vertical_part_counts() -> None:
    roll = math.radians(30.0)
    turned = np.tile([0.0, math.sin(roll), math.cos(roll)], (TIME.size, 1)) * 0.2
    attitude = Series.of(TIME, np.tile([roll, 0.0, 1.0], (TIME.size, 1)))
    turn = turn_record(gyro_of(turned, attitude_rad=attitude))
    assert turn is not None
    assert turn.angle_rad == pytest.approx(0.2 * TIME) and np.abs(turn.tilt_rate_radps).max() < 1e-12


def test_numbers_cut_toward_zero_are_put_right() -> None:
    rates = np.stack([0.0 * TIME, 0.0 * TIME, np.where(TIME < 5.0, 0.010, -0.010)], axis=1)
    turn = turn_record(gyro_of(rates, gyro_truncation_radps=0.001))
    assert turn is not None and np.abs(turn.rate_radps) == pytest.approx(np.full(TIME.size, 0.0105))
    assert not turn.tilt_rate_radps.any()  # a zero is a zero


def test_what_is_missing_is_left_out() -> None:
    assert turn_record(Track()) is None
    rates = np.full((TIME.size, 3), 0.1)
    assert turn_record(gyro_of(rates[:2], TIME[:2])) is None
    assert turn_record(gyro_of(rates[:3], TIME[:3])) is not None
    rates[3:] = np.nan
    turn = turn_record(gyro_of(rates))
    assert turn is not None and turn.time_s.tolist() == [0.0, 0.25, 0.5]
    rates[2, 0] = np.inf
    assert turn_record(gyro_of(rates)) is None


def standing(seconds: float, deg_s: float, field_mgauss: FloatArray | None = None) -> Track:
    time = np.arange(0.0, seconds + 0.01, 0.1)
    if field_mgauss is None:
        field_mgauss = [200.0, 0.0, 400.0] + 1e-6 * np.where(np.arange(time.size) % 2, 1.0, -1.0)[
            :, np.newaxis
        ]
    rates = np.tile([0.0, 0.0, deg_s * DEG], (time.size, 1))
    compasses = {1: MagSeries(1, Series.of(time, field_mgauss))}
    return gyro_of(rates, time, compasses=compasses, autopilot="ardupilot")


def test_a_field_that_moves_shows_a_turn() -> None:
    time = np.arange(0.0, 2.81, 0.1)
    psi = 0.5 * DEG * time
    noise = 0.02 * np.where(np.arange(time.size) % 2, 1.0, -1.0)
    field = np.stack([200.0 * np.cos(psi) + noise, -200.0 * np.sin(psi) + noise, 0.0 * psi], axis=1)
    turn = turn_record(standing(2.8, 0.5, field))
    assert turn is not None
    assert turn.bias_radps == 0.0 and turn.bias_sigma_radps == pytest.approx(0.2 * DEG)
