"""The turned angle by the gyro: what it is, what is not known of it, and where the bias is found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record, turning
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
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


# --- The gyro's bias about the vertical: from stretches without turning, and never from the ends of turns


RATE_HZ = 25.0
FIELD_MGAUSS, NOISE_MGAUSS = 230.0, 6.0


def turning_in_steps(bias_deg_s: float, seed: int, creep_deg_s: float = 0.0) -> Track:
    """Make a vehicle that stands for two seconds and turns on for three, slowly and not quite steadily."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 26.0, 1.0 / RATE_HZ)
    phase = (time + rng.uniform(0.0, 5.0)) % 5.0
    rate = np.where(
        phase < 2.0, math.radians(creep_deg_s), math.radians(30.0) * np.sin((phase - 2.0) * 1.047)
    )
    yaw = np.cumsum(rate) / RATE_HZ
    field = FIELD_MGAUSS * np.stack([np.cos(yaw), -np.sin(yaw), np.full_like(yaw, 2.0)], axis=1)
    field += NOISE_MGAUSS * rng.standard_normal(field.shape)
    measured = rate + math.radians(bias_deg_s) + math.radians(0.1) * rng.standard_normal(time.size)
    gyro = np.column_stack([np.zeros_like(rate), np.zeros_like(rate), measured])
    return Track(
        autopilot="ardupilot",
        vehicle="rover",
        gyro_radps=Series.of(time, gyro),
        acc_mps2=Series.of(time, np.tile([0.0, 0.0, -9.80665], (time.size, 1))),
        compasses={1: MagSeries(1, Series.of(time, field))},
    )


@pytest.mark.parametrize("bias_deg_s", [-0.15, 0.0, 0.15])
def test_the_ends_of_turns_do_not_pass_for_bias(bias_deg_s: float) -> None:
    records = [turn_record(turning_in_steps(bias_deg_s, seed)) for seed in range(12)]
    errors = [math.degrees(r.bias_radps) - bias_deg_s for r in records if r is not None]
    sigmas = [math.degrees(r.bias_sigma_radps) for r in records if r is not None]
    # Nothing is believed that is worse than what was known before: 0.2 deg/s about zero.
    assert len(errors) == 12
    assert max(map(abs, errors)) < abs(bias_deg_s) + 0.03
    assert all(abs(error) < 2.0 * sigma for error, sigma in zip(errors, sigmas, strict=True))


@pytest.mark.parametrize(
    ("bias_deg_s", "off_deg_s", "known"),
    [(0.3, 0.05, {"autopilot": "ardupilot", "vehicle": "rover"}), (6.0, 0.1, {})],
    ids=["an autopilot's", "a bare gyro's"],
)
def test_a_vehicle_that_only_stands_shows_its_whole_bias(
    bias_deg_s: float, off_deg_s: float, known: dict[str, str]
) -> None:
    time = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
    rng = np.random.default_rng(3)
    field = np.tile([200.0, -50.0, 400.0], (time.size, 1)) + 0.5 * rng.standard_normal((time.size, 3))
    track = Track(
        gyro_radps=Series.of(time, np.tile([0.0, 0.0, math.radians(bias_deg_s)], (time.size, 1))),
        acc_mps2=Series.of(time, np.tile([0.0, 0.0, -9.80665], (time.size, 1))),
        compasses={1: MagSeries(1, Series.of(time, field))},
        **known,
    )
    record = turn_record(track)
    assert record is not None
    assert math.degrees(record.bias_radps) == pytest.approx(bias_deg_s, abs=off_deg_s)
    assert not known or math.degrees(record.bias_sigma_radps) < 0.15


def test_a_bias_that_drifts_is_followed() -> None:
    """A gyro that warms up by 0.05 deg/s a minute, as a firmware's simulator has it."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 200.0, 1.0 / RATE_HZ)
    yaw = np.radians(30.0) * np.clip(time - 100.0, 0.0, 12.0)
    drift = np.radians(0.05 / 60.0) * time
    field = FIELD_MGAUSS * np.stack([np.cos(yaw), -np.sin(yaw), np.full_like(yaw, 2.0)], axis=1)
    field += 0.5 * rng.standard_normal(field.shape)
    gyro = np.gradient(yaw, time) + drift
    track = Track(
        autopilot="ardupilot",
        vehicle="copter",
        gyro_radps=Series.of(time, np.column_stack([0.0 * time, 0.0 * time, gyro])),
        acc_mps2=Series.of(time, np.tile([0.0, 0.0, -9.80665], (time.size, 1))),
        compasses={1: MagSeries(1, Series.of(time, field))},
    )
    record = turn_record(track)
    assert record is not None
    # One bias for all would be four degrees off.
    assert math.degrees(float(np.ptp(record.angle_rad - yaw))) < 0.7


def test_hours_of_standing_are_averaged_in_groups() -> None:
    middle = np.arange(0.0, 6000.0, 3.0)
    wave = 0.002 * np.sin(middle / 1000.0)
    seen = [(float(m), float(w), 0.001) for m, w in zip(middle, wave, strict=True)]
    bias, sigma = turning._drifting(middle, seen, 0.01)
    assert np.abs(bias - wave)[20:-20].max() < 1e-4 and 0.0 < sigma < 0.001


STEP_S = 0.04


def record_of(noise_radps: FloatArray) -> TurnRecord:
    """Record a vehicle that rolls and pitches while it turns, with a noise (N, 3) in its gyro's readings."""
    time = STEP_S * np.arange(len(noise_radps))
    roll, pitch = 0.2 * np.sin(0.7 * time), 0.15 * np.sin(0.4 * time + 1.0)
    roll_rate, pitch_rate = np.gradient(roll, time), np.gradient(pitch, time)
    yaw_rate = 0.3 * np.sin(0.1 * time)
    rates = np.stack(
        [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch),
            -pitch_rate * np.sin(roll) + yaw_rate * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )
    attitude = np.stack([roll, pitch, np.zeros_like(roll)], axis=1)
    track = Track(
        gyro_radps=Series.of(time, rates + noise_radps),
        attitude_rad=Series.of(time, attitude),
        acc_mps2=Series.of(time, np.tile([0.0, 0.0, -9.80665], (time.size, 1))),
    )
    record = turn_record(track)
    assert record is not None
    return record


def test_white_noise_walks_as_its_readings_say() -> None:
    white = np.random.default_rng(5).normal(0.0, 0.02, (5000, 3))
    record = record_of(white)
    assert record.walk_rad == pytest.approx(0.02 * math.sqrt(STEP_S), rel=0.2)
    assert record.independent_sigma_rad(10.0, 14.0) >= 2.0 * record.walk_rad


def test_vibration_is_in_every_reading_and_in_no_angle() -> None:
    shaking = 0.1 * np.where(np.arange(5000) % 2, 1.0, -1.0)[:, np.newaxis] * np.ones(3)
    record = record_of(shaking)
    assert record.noise_radps > 0.1
    assert record.walk_rad < math.radians(0.05)


# --- A vehicle that leans round and round turns its nose without any rate about the vertical


LEAN_RAD, PERIOD_S, ROUNDS = math.radians(15.0), 4.0, 3
LEANING_S = np.arange(0.0, ROUNDS * PERIOD_S + 1e-9, 0.01)


def circling(yaw_radps: float) -> Track:
    """A copter that leans 15 degrees to every side in turn while its nose turns at a rate."""
    phase = 2.0 * math.pi * LEANING_S / PERIOD_S
    roll, pitch, yaw = LEAN_RAD * np.cos(phase), LEAN_RAD * np.sin(phase), yaw_radps * LEANING_S
    angles = zip(roll, pitch, yaw, strict=True)
    rotation = np.array([rotation_matrix(*angle) for angle in angles]).reshape(-1, 3, 3)
    turn = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    between = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) / 0.01
    rate = np.concatenate([between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]])
    field = Series.of(LEANING_S[::10], np.tile([200.0, 0.0, -500.0], (LEANING_S[::10].size, 1)))
    return Track(
        autopilot="ardupilot",
        vehicle="copter",
        compasses={1: MagSeries(1, field)},
        gyro_radps=Series.of(LEANING_S, rate),
        attitude_rad=Series.of(LEANING_S, np.column_stack([roll, pitch, yaw])),
    )


@pytest.mark.parametrize("yaw_radps", [0.0, 0.3, -0.5])
def test_the_angle_is_the_noses_whatever_the_vehicle_leans(yaw_radps: float) -> None:
    record = turn_record(circling(yaw_radps))
    assert record is not None
    turned = record.angle_rad[-1] - record.angle_rad[0] + record.bias_radps * (LEANING_S[-1] - LEANING_S[0])
    assert turned == pytest.approx(yaw_radps * LEANING_S[-1], abs=math.radians(0.2))
    # Twelve degrees a round: the area that the lean goes round.
    about_the_vertical = float(np.trapezoid(record.rate_radps + record.bias_radps, LEANING_S))
    assert abs(about_the_vertical - turned) == pytest.approx(ROUNDS * math.pi * LEAN_RAD**2, rel=0.05)
