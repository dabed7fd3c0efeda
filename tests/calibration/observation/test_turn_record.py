"""The turned angle by the gyro: what it is, what is not known of it, and where the bias is found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record
from mavcompass.calibration.observation.turning import (
    TurnRecord,
    _drifting,
    _quiet_stretches,
    _slope,
)
from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track

DEG = math.radians(1.0)
TIME = np.arange(0.0, 10.01, 0.25)


def record(rate_radps: FloatArray, time: FloatArray = TIME, walk_rad: float = 0.0) -> TurnRecord:
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate_radps[1:] + rate_radps[:-1]) * np.diff(time))])
    return TurnRecord(time, angle, rate_radps, 0.0 * time, 0.0, 0.0, 0.0, walk_rad, 0.25)


def gyro_of(rates: FloatArray, time: FloatArray = TIME, **more: Any) -> Track:
    return Track(gyro_radps=Series.of(time, rates), **more)


def test_noise_walks_with_the_root_of_time() -> None:
    turn = record(0.0 * TIME, walk_rad=0.01)
    assert turn.independent_sigma_rad(2.0, 6.0) == pytest.approx(0.02)
    assert turn.independent_sigma_rad(2.0, 3.0) == pytest.approx(0.01)
    assert turn.independent_sigma_rad(3.0, 2.0) == math.inf  # nothing lies between
    assert turn.independent_sigma_rad(50.0, 51.0) == math.inf


def test_a_rate_that_bends_between_samples_is_less_certain() -> None:
    # rate = t^2: each trapezoid of 1/4 s misses h^3/12 * 2, and so do eight of them, independently.
    sigma = record(TIME**2).independent_sigma_rad(2.1, 4.1)
    assert sigma == pytest.approx(math.sqrt(8.0) * 0.25**3 / 6.0)
    assert record(3.0 * TIME).independent_sigma_rad(2.1, 4.1) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("gap_s", "lost"), [(0.45, 0.0), (0.8, 0.8 * 0.2)])
def test_a_gap_loses_what_the_rate_changed(gap_s: float, lost: float) -> None:
    time = np.where(TIME <= 3.0, TIME, TIME + gap_s - 0.25)
    rate = np.where(TIME <= 3.0, 0.1, -0.1)
    whole = record(rate, time).independent_sigma_rad(1.0, 6.0)
    before, after = 0.5 * (0.25 + gap_s) / 12.0 * 0.2, 0.5 * (0.25 + gap_s) / 12.0 * 0.2
    assert whole == pytest.approx(math.hypot(before, after, lost))


def test_angle_and_rate_are_read_between_samples() -> None:
    turn = record(0.2 * TIME)
    assert turn.angle_at(np.array([3.125])) == pytest.approx([0.1 * 3.125**2], abs=0.002)
    assert turn.rate_at(np.array([3.125, 99.0])) == pytest.approx([0.625, 2.0])


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


@pytest.mark.parametrize(
    ("autopilot", "deg_s"), [("ardupilot", 0.2), ("px4", 0.2), ("unknown", 3.0), ("other", 3.0)]
)
def test_without_a_compass_the_bias_is_what_is_usual(autopilot: str, deg_s: float) -> None:
    turn = turn_record(gyro_of(np.full((TIME.size, 3), 0.1), autopilot=autopilot))
    assert turn is not None and turn.bias_sigma_radps == pytest.approx(deg_s * DEG)


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


def test_noise_is_seen_beside_turning() -> None:
    time = np.arange(3000.0) * 0.02
    rates = np.random.default_rng(3).normal(0.0, 0.01, (time.size, 3))
    rates[:, 2] += 0.5 * np.sin(time)
    turn = turn_record(gyro_of(rates, time))
    assert turn is not None
    assert turn.noise_radps == pytest.approx(0.01, rel=0.08)
    assert turn.walk_rad == pytest.approx(turn.noise_radps * math.sqrt(0.02))


@pytest.mark.parametrize(("lasts_s", "is_witnessed"), [(19.5, False), (20.5, True)])
def test_roll_and_pitch_bear_witness_of_twenty_seconds(lasts_s: float, is_witnessed: bool) -> None:
    time = np.arange(0.0, lasts_s, 0.04)
    shaking = 0.1 * np.where(np.arange(time.size) % 2, 1.0, -1.0)[:, np.newaxis] * np.ones(3)
    level = Series.of(time, np.zeros((time.size, 3)))
    turn = turn_record(gyro_of(shaking, time, attitude_rad=level))
    assert turn is not None
    usual = turn.noise_radps * math.sqrt(0.04)
    assert turn.walk_rad == pytest.approx(0.02 * DEG if is_witnessed else usual, rel=0.02)


def standing(seconds: float, deg_s: float, field_mgauss: FloatArray | None = None) -> Track:
    time = np.arange(0.0, seconds + 0.01, 0.1)
    if field_mgauss is None:
        field_mgauss = [200.0, 0.0, 400.0] + 1e-6 * np.where(np.arange(time.size) % 2, 1.0, -1.0)[
            :, np.newaxis
        ]
    rates = np.tile([0.0, 0.0, deg_s * DEG], (time.size, 1))
    compasses = {1: MagSeries(1, Series.of(time, field_mgauss))}
    return gyro_of(rates, time, compasses=compasses, autopilot="ardupilot")


def test_the_bias_is_what_a_gyro_shows_while_the_field_rests() -> None:
    turn = turn_record(standing(2.8, 0.3))
    assert turn is not None
    # One stretch tells 0.01 deg/s, beside 0.2 deg/s that were known before.
    share = 0.2**2 / (0.2**2 + 0.01**2)
    assert turn.bias_radps == pytest.approx(0.3 * share * DEG)
    assert turn.angle_rad[-1] == pytest.approx(2.8 * 0.3 * (1.0 - share) * DEG)  # it is taken out
    assert turn.bias_sigma_radps == pytest.approx(0.01 * math.sqrt(share) * DEG)
    longer = turn_record(standing(12.0, 0.3))
    assert longer is not None  # four stretches count as no more than two
    assert longer.bias_sigma_radps == pytest.approx(0.01 / math.sqrt(2.0) * DEG)


@pytest.mark.parametrize(("deg_s", "is_bias"), [(0.95, True), (1.05, False), (-0.95, True), (-1.05, False)])
def test_what_turns_faster_than_a_bias_can_is_a_turn(deg_s: float, is_bias: bool) -> None:
    turn = turn_record(standing(2.8, deg_s))
    assert turn is not None
    assert turn.bias_radps == pytest.approx(deg_s * DEG if is_bias else 0.0, rel=0.01)


def test_a_field_that_moves_shows_a_turn() -> None:
    time = np.arange(0.0, 2.81, 0.1)
    psi = 0.5 * DEG * time
    noise = 0.02 * np.where(np.arange(time.size) % 2, 1.0, -1.0)
    field = np.stack([200.0 * np.cos(psi) + noise, -200.0 * np.sin(psi) + noise, 0.0 * psi], axis=1)
    turn = turn_record(standing(2.8, 0.5, field))
    assert turn is not None
    assert turn.bias_radps == 0.0 and turn.bias_sigma_radps == pytest.approx(0.2 * DEG)


def test_noise_of_the_field_hides_a_turn_the_more_the_weaker_it_is() -> None:
    time = np.arange(0.0, 10.81, 0.1)
    noise = 2.0 * math.sqrt(1.5) * (np.arange(time.size) % 3 - 1.0)[:, np.newaxis]
    rate = np.where(time < 2.85, 0.0, np.where(time < 10.75, 45.0 * DEG, 0.0))
    for level_mgauss, counts_mgauss in ((200.0, 200.0), (30.0, 50.0)):  # a weaker one is not believed
        psi = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.1)])
        field = level_mgauss * np.stack([np.cos(psi), -np.sin(psi), 0.0 * psi], axis=1) + noise
        gyro = np.stack([0.0 * rate, 0.0 * rate, rate + 0.1 * DEG], axis=1)
        compass = MagSeries(1, Series.of(time, field + np.array([0.0, 300.0, 500.0])))
        turn = turn_record(gyro_of(gyro, time, compasses={1: compass}, autopilot="px4"))
        assert turn is not None
        stood = slice(0, 27)
        slope, sigma = _slope(time[stood], field[stood], 0.0)
        known = math.sqrt(float(slope @ slope) + 2.0 * sigma**2) / counts_mgauss / DEG
        usual = 1.0 / math.sqrt(0.2**-2 + known**-2)
        assert turn.bias_sigma_radps / DEG == pytest.approx(usual, rel=0.12)


def test_too_few_readings_tell_no_bias() -> None:
    turn = turn_record(standing(2.8, 0.3), instance=2)
    assert turn is not None and turn.bias_radps == 0.0
    for count, tells in ((7, False), (8, True)):
        track = standing(2.8, 0.3)
        whole = track.compasses[1].reported
        few = Series.of(whole.time_s[:count], whole.values[:count])
        turn = turn_record(Track(gyro_radps=track.gyro_radps, compasses={1: MagSeries(1, few)}))
        assert turn is not None and (turn.bias_radps > 0.0) is tells


def test_a_bias_drifts_between_what_two_stretches_tell() -> None:
    at, sigma = np.array([0.0, 5.0, 1e5, 2e5]), 0.01 * DEG
    bias, usual = _drifting(at, [], 0.2)
    assert bias.tolist() == [0.0] * 4 and usual == 0.2
    bias, usual = _drifting(at, [(5.0, 0.1, sigma)], sigma)
    assert bias == pytest.approx([0.05] * 4)  # as certain as what was known before
    assert usual == pytest.approx(sigma / math.sqrt(2.0))
    # A smooth drift of 0.07 deg/s, 100 s long: near stretches share it, their difference is mostly chance.
    for apart_s, share in ((10.0, 0.196), (50.0, 0.852), (1e5, 0.980)):
        drifted = 0.07**2 * (1.0 - math.exp(-0.5 * (apart_s / 100.0) ** 2))
        assert share == pytest.approx(drifted / (drifted + 0.01**2), abs=1e-3)
        bias, usual = _drifting(
            np.array([0.0, 0.5 * apart_s, 2e5]), [(0.0, 0.0, sigma), (apart_s, 0.3, sigma)], 1.0
        )
        assert bias == pytest.approx([0.15 - 0.15 * share, 0.15, 0.15 + 0.15 * share], abs=2e-4)
        assert sigma / math.sqrt(2.0) <= usual * 1.001 and usual < sigma


def quiet(deg_s: FloatArray, time: FloatArray, limit_deg_s: float = 15.0) -> list[list[float]]:
    return [[round(a, 2), round(b, 2)] for a, b in _quiet_stretches(time, deg_s * DEG, limit_deg_s * DEG)]


def test_quiet_is_what_stands_most_of_the_time() -> None:
    time = np.arange(0.0, 13.999, 0.05)
    rate = np.where((time > 6.99) & (time < 9.99), 10.0, 0.1)
    # The mean over half a second leaves the standing by one degree per second after 0.2 s less.
    assert quiet(rate, time) == [[0.0, 2.25], [2.25, 4.5], [4.5, 6.75], [10.2, 12.08], [12.08, 13.95]]
    assert quiet(rate, time, 5.0) == quiet(rate, time)
    assert quiet(rate + 7.0, time) == quiet(rate, time)
    assert quiet(rate + 7.0, time, 5.0) == []
    assert quiet(np.where(time < 9.0, rate, 10.0), time)[-1][1] == 6.75  # what turns longest is no standing


@pytest.mark.parametrize(("lasts_s", "found"), [(0.9, False), (1.1, True)])
def test_a_second_of_rest_is_a_stretch(lasts_s: float, found: bool) -> None:
    time = np.arange(0.0, lasts_s + 0.001, 0.05)
    assert bool(quiet(0.0 * time, time)) is found


def test_a_stretch_lasts_three_seconds_at_most() -> None:
    for lasts_s, count in ((2.99, 1), (3.0, 1), (3.1, 2), (6.1, 3)):
        time = np.linspace(0.0, lasts_s, 200)
        assert len(quiet(0.0 * time, time)) == count
    assert quiet(np.array([0.0, 9.0, 0.0, 9.0, 0.0]), np.arange(0.0, 5.0)) == []
    assert quiet(np.zeros(3), np.array([0.0, 1.0, 2.0])) == []
    assert quiet(np.zeros(4), np.array([0.0, 1.0, 2.0, 3.0])) == [[0.0, 3.0]]


def test_a_creep_of_the_field_is_known_to_its_noise_and_its_step() -> None:
    time = np.arange(41.0) * 0.1
    straight = 7.0 + time[:, np.newaxis] * [1.0, -2.0, 0.5]
    slope, sigma = _slope(time, straight, 0.0)
    assert slope == pytest.approx([1.0, -2.0, 0.5]) and sigma == pytest.approx(0.0, abs=1e-9)
    _, hidden = _slope(time, straight, 2.0)
    assert hidden == pytest.approx(2.0 / math.sqrt(12.0) / 4.0)
    power = float(((time - 2.0) ** 2).sum())
    noise = 3.0 * np.where(np.arange(41) % 2, 1.0, -1.0)[:, np.newaxis] * np.ones(3)
    slope, sigma = _slope(time, straight + noise, 0.0)
    assert slope == pytest.approx([1.0, -2.0, 0.5], abs=0.01)
    # The mean square of three axes, half as much again, of 40 fresh readings.
    assert sigma == pytest.approx(3.0 * math.sqrt(1.5 * 41 / 40 / power), rel=1e-3)
    # Read five times as often, it tells no more: readings are repeated.
    often = np.arange(201.0) * 0.02
    again = 3.0 * np.where(np.arange(201) % 2, 1.0, -1.0)[:, np.newaxis] * np.ones(3)
    assert _slope(often, again, 0.0)[1] == pytest.approx(sigma, rel=0.03)
    assert _slope(np.ones(5), np.zeros((5, 3)), 0.0)[1] == math.inf


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.4, -0.3)])
def test_what_roll_and_pitch_witness_is_the_walk_of_the_sum(roll: float, pitch: float) -> None:
    time = np.arange(0.0, 40.0, 0.04)
    shaking = 0.5 * np.where(np.arange(time.size) % 2, 1.0, -1.0)
    # It turns at a steady lean; summed, it rolls and pitches by 0.02 in most stretches of two seconds.
    off, turning = 0.01 * (time // 2.0 % 3.0 - 1.0), 0.3
    rates = [
        off - turning * math.sin(pitch),
        off * math.cos(roll) + turning * math.cos(pitch) * math.sin(roll),
        -off * math.sin(roll) + turning * math.cos(pitch) * math.cos(roll),
    ]
    attitude = Series.of(time, np.tile([roll, pitch, 0.0], (time.size, 1)))
    turn = turn_record(gyro_of(np.stack(rates, 1) + shaking[:, np.newaxis], time, attitude_rad=attitude))
    assert turn is not None
    # A normal walk is within 0.6745 sigma half of the time.
    assert turn.walk_rad == pytest.approx(0.02 / 0.6745 / math.sqrt(2.0), rel=0.03)
