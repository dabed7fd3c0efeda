"""How far a gyro's angle walks: by the noise of its readings, or less where roll and pitch bear witness."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation import turn_record
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray
from mavcompass.track import Series, Track

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
