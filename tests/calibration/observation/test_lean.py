"""What an accelerometer may be off by, seen from the lean that turns with the vehicle: equation (L1)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation.dwells import UNSEEN_BIAS_RAD, accelerometer_sigma_rad
from mavcompass.frames import FloatArray

TURNED = np.radians([0.0, 90.0, 180.0, 270.0])
NOISE = np.full(4, math.radians(0.03))


def seen(lean_deg: float, slope_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    lean, slope = math.radians(lean_deg), math.radians(slope_deg)
    return lean + slope * np.cos(TURNED), -slope * np.sin(TURNED)


def sigma_deg(lean_deg: float, slope_deg: float = 0.0) -> float:
    return math.degrees(accelerometer_sigma_rad(TURNED, *seen(lean_deg, slope_deg), NOISE))


def test_what_stands_upright_has_a_good_accelerometer() -> None:
    assert sigma_deg(0.0) == pytest.approx(math.degrees(0.001), rel=0.15)


def test_a_lean_is_the_accelerometers_as_far_as_that_is_likely() -> None:
    assert sigma_deg(0.0) < sigma_deg(0.1) < sigma_deg(0.3) < sigma_deg(0.8)
    assert 0.3 < sigma_deg(0.8) < 0.8
    # So far over no accelerometer is: it is how the vehicle stands.
    assert sigma_deg(5.0) < sigma_deg(1.0)


@pytest.mark.parametrize("slope_deg", [1.0, 4.0])
def test_the_slope_of_the_ground_is_none_of_it(slope_deg: float) -> None:
    assert sigma_deg(0.0, slope_deg) == pytest.approx(sigma_deg(0.0), rel=0.2)


def test_without_a_turn_lean_and_slope_are_one() -> None:
    turned = np.zeros(4)
    flat = accelerometer_sigma_rad(turned, np.zeros(4), np.zeros(4), NOISE)
    assert flat > 3.0 * accelerometer_sigma_rad(TURNED, np.zeros(4), np.zeros(4), NOISE)


def test_what_shows_nothing_leaves_it_as_likely_as_before() -> None:
    """So that what travels, whose lean tells nothing, claims no less than what stands and shows little."""
    nothing = accelerometer_sigma_rad(TURNED, np.zeros(4), np.zeros(4), np.full(4, 10.0))
    assert nothing == pytest.approx(UNSEEN_BIAS_RAD, rel=0.05)
