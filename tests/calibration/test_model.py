"""The model's own numbers: how a covariance becomes a heading's sigma."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.model import (
    GAIN,
    HORIZONTAL,
    VERTICAL,
    HeadingError,
    gain_matrix,
    gain_parameters,
)


def error_of(covariance: np.ndarray) -> HeadingError:
    state = np.zeros(11)
    state[GAIN], state[HORIZONTAL], state[VERTICAL] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0], 200.0, 400.0
    return HeadingError(state, covariance)


def test_an_offset_turns_the_heading_by_its_part_across() -> None:
    error = error_of(np.diag([9.0, 0, 0, 0, 0, 0, 0, 0, 0]))  # 3 mG along x
    assert error.sigma_rad([0.0, 0.5 * math.pi, math.radians(30.0)]) == pytest.approx(
        [0.0, 3.0 / 200.0, 1.5 / 200.0]
    )
    assert error.rms_rad() == pytest.approx(3.0 / 200.0 / math.sqrt(2.0))
    # A nose-up vehicle shows the sensor's z ahead: sin 30 of it.
    error = error_of(np.diag([0, 0, 9.0, 0, 0, 0, 0, 0, 0]))
    assert error.rms_rad() == 0.0
    up = error.sigma_rad(0.5 * math.pi, pitch_rad=math.radians(30.0))
    assert up == pytest.approx([1.5 / 200.0])
    assert error.rms_rad(pitch_rad=math.radians(30.0)) == pytest.approx(1.5 / 200.0 / math.sqrt(2.0))


def test_a_gain_turns_the_heading_twice_a_circle() -> None:
    error = error_of(np.diag([0, 0, 0, 0.04**2, 0, 0, 0, 0, 0]))
    # atan2(s, (1 + g) c) - psi = -g sin(2 psi) / 2
    assert error.sigma_rad([0.0, 0.25 * math.pi, 0.5 * math.pi]) == pytest.approx([0.0, 0.02, 0.0], abs=1e-12)
    assert error.rms_rad() == pytest.approx(0.02 / math.sqrt(2.0))


def test_six_numbers_are_a_symmetric_matrix() -> None:
    matrix = gain_matrix([1.0, 2.0, 3.0, 0.4, 0.5, 0.6])
    np.testing.assert_array_equal(matrix, [[1.0, 0.4, 0.5], [0.4, 2.0, 0.6], [0.5, 0.6, 3.0]])
    np.testing.assert_array_equal(gain_parameters(matrix), [1.0, 2.0, 3.0, 0.4, 0.5, 0.6])
