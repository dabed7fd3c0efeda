"""Derivatives and rotations that the attitude is made of."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from mavcompass.gap.attitude.kinematics import exponentials, rotation_vectors, second_derivative


@pytest.mark.parametrize("window", [5, 9, 21])
def test_a_cubic_has_its_second_derivative_everywhere(window: int) -> None:
    time = np.arange(60) * 0.1
    values = np.stack([2.0 - time + 3.0 * time**2 - 0.5 * time**3, time**2], axis=1)
    expected = np.stack([6.0 - 3.0 * time, np.full(60, 2.0)], axis=1)
    np.testing.assert_allclose(second_derivative(values, window, 0.1), expected, atol=1e-8)


def test_of_noise_it_is_the_filter_of_savitzky_and_golay() -> None:
    values = np.random.default_rng(3).standard_normal((80, 3))
    theirs = scipy.signal.savgol_filter(values, 9, 3, deriv=2, delta=0.02, axis=0)
    np.testing.assert_allclose(second_derivative(values, 9, 0.02), theirs, rtol=1e-7, atol=1e-6)


def test_exponentials_are_scipys_rotations_and_their_vectors_come_back() -> None:
    vectors = np.random.default_rng(4).uniform(-1.5, 1.5, (200, 3))
    vectors[:3] = [[0.0, 0.0, 0.0], [1e-12, 0.0, 0.0], [1e-5, -1e-5, 0.0]]
    rotations = exponentials(vectors)
    theirs = scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotations, theirs, atol=1e-12)
    np.testing.assert_allclose(rotation_vectors(rotations), vectors, atol=1e-9)
