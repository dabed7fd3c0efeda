"""The turn back: its figures in closed form, each cause at its limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, body_field, four_positions

from mavcompass.calibration import solve_four_positions
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import repeat_test
from mavcompass.errors import PoorCalibration

LAST = 0.4 + 1.5 * math.pi


def turned_back(off_deg: tuple[float, ...], noise_mgauss: float = 1.0) -> FourPositionData:
    """A perfect turn back whose compass is off by so much at each position."""
    back = four_positions(Iron(), first=LAST, turns=np.full(len(off_deg) - 1, -0.5 * math.pi), gyro_sigma=0.0)
    psi = LAST - 0.5 * math.pi * np.arange(len(off_deg)) + np.radians(off_deg)
    noise = np.diag([noise_mgauss**2, noise_mgauss**2, 1e4])
    dwells = [
        replace(dwell, mean_mgauss=row, covariance_mgauss2=noise)
        for dwell, row in zip(back.dwells, body_field(psi), strict=True)
    ]
    return replace(back, dwells=tuple(dwells))


def test_the_figures_are_those_of_the_headings() -> None:
    forward = four_positions(Iron())
    test = repeat_test(forward, turned_back((0.0, 2.0, 2.0, 2.0)), earth=FIELD)
    assert np.degrees(test.difference_rad) == pytest.approx([0.0, 2.0, 2.0, 2.0], abs=0.01)
    assert test.cause == "hysteresis" and test.position == -1
    assert math.degrees(test.hysteresis_rad) == pytest.approx(1.0, abs=0.01)
    # Half the rms of 0, 2, 2, 2.
    assert math.degrees(test.heading_rms_rad) == pytest.approx(0.5 * math.sqrt(3.0), abs=0.01)
    # Each heading: 1 mG of 238, and what the forward turn leaves; the three are averaged.
    own = solve_four_positions(forward, earth=FIELD).heading_sigma_rad
    each = math.hypot(1.0 / FIELD.horizontal_mgauss, own)
    assert test.sigma_rad == pytest.approx(np.full(4, each), rel=0.01)
    assert test.hysteresis_sigma_rad == pytest.approx(0.5 * each / math.sqrt(3.0), rel=0.01)
    assert "+2.0 degrees" in test.words


def test_each_heading_is_as_sure_as_noise_gyro_bias_and_scale_allow() -> None:
    forward, back = four_positions(Iron()), turned_back((0.0, 0.0, 0.0, 0.0), noise_mgauss=2.0)
    back = replace(
        back,
        steps=tuple(replace(step, sigma_rad=0.01, duration_s=10.0) for step in back.steps),
        gyro_bias_sigma_radps=2e-4,
        gyro_scale_sigma=0.003,
    )
    k = np.arange(4.0)
    parts = [2.0 / FIELD.horizontal_mgauss, 0.01 * np.sqrt(k), 10.0 * k * 2e-4, 0.5 * math.pi * k * 0.003]
    own = solve_four_positions(forward, earth=FIELD).heading_sigma_rad
    expected = np.sqrt(sum(np.square(part) for part in parts) + own**2)
    assert repeat_test(forward, back, earth=FIELD).sigma_rad == pytest.approx(expected, rel=0.01)


def test_a_position_that_stands_out_is_named_with_its_sign() -> None:
    test = repeat_test(four_positions(Iron()), turned_back((0.0, 0.0, -5.0, 0.0)), earth=FIELD)
    assert (test.cause, test.position) == ("disturbance", 2)
    assert test.words.startswith("Position 3 ") and "-5.0 degrees" in test.words


def test_two_positions_tell_nothing_and_three_do() -> None:
    forward = four_positions(Iron())
    with pytest.raises(PoorCalibration, match="only 2 positions"):
        repeat_test(forward, turned_back((0.0, 0.0)), earth=FIELD)
    assert repeat_test(forward, turned_back((0.0, 0.0, 0.0)), earth=FIELD).cause == "repeats"


def test_turns_that_agree_but_with_no_rigid_compass_are_a_misfit() -> None:
    forward = four_positions(Iron(), turns=np.radians([60.0] * 6), noise=1.0, gyro_sigma=0.001)
    bent = [
        replace(dwell, mean_mgauss=dwell.mean_mgauss + 9.0 * np.array([0.0, 0.0, (-1.0) ** k]))
        for k, dwell in enumerate(forward.dwells)
    ]
    forward = replace(forward, dwells=tuple(bent))
    back = replace(
        forward,
        dwells=forward.dwells[::-1],
        steps=tuple(replace(step, angle_rad=-step.angle_rad) for step in forward.steps[::-1]),
    )
    test = repeat_test(forward, back, earth=FIELD)
    assert test.cause == "misfit" and "not with a rigid compass" in test.words
