"""The tilt of a position: the mean of the level over it, and what a swing and the lag leave unknown."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation.dwells import tilt_during
from mavcompass.frames import FloatArray
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
TIME = np.arange(41.0) * 0.1
DEG = math.radians(1.0)


def force(roll_deg: float, pitch_deg: float) -> FloatArray:
    roll, pitch = roll_deg * DEG, pitch_deg * DEG
    return -G * np.array(
        [-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)]
    )


def told(lag_sigma_s: float = 0.0, **recorded: Any) -> tuple[float, float, float]:
    roll, pitch, sigma = tilt_during(Track(vehicle="boat", **recorded), TIME, lag_sigma_s)
    return roll / DEG, pitch / DEG, sigma / DEG


def attitude(roll_deg: FloatArray | float, pitch_deg: FloatArray | float = 0.0) -> Series:
    return Series.of(TIME, np.stack(np.broadcast_arrays(roll_deg * DEG, pitch_deg * DEG, 0.0 * TIME), axis=1))


def test_level_where_nothing_was_recorded() -> None:
    assert told() == pytest.approx((0.0, 0.0, 0.02))


def test_what_stands_is_as_level_as_its_accelerometer_says() -> None:
    still = Series.of(TIME, np.tile(force(3.0, -2.0), (41, 1)))
    assert told(acc_mps2=still) == pytest.approx((3.0, -2.0, math.hypot(0.02, 0.05)))
    gap = np.tile(force(3.0, -2.0), (41, 1))
    gap[5:20] = np.nan
    assert told(acc_mps2=Series.of(TIME, gap))[:2] == pytest.approx((3.0, -2.0))


def test_the_lag_matters_while_it_tilts() -> None:
    leaning = attitude(2.0 * TIME)
    sure, unsure = told(attitude_rad=leaning)[2], told(0.03, attitude_rad=leaning)[2]
    assert math.sqrt(unsure**2 - sure**2) == pytest.approx(2.0 * 0.03, rel=0.01)
    # A swing of eight degrees, halfway between its ends, is no small angle.
    assert sure == pytest.approx(math.hypot(0.2, 0.02, 0.5 * (8.0 * DEG) ** 2 / 12.0 / DEG), rel=0.1)
