"""The gyro's bias about the vertical: from stretches without turning, and never from the ends of turns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record, turning
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray
from mavcompass.track import MagSeries, Series, Track

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
