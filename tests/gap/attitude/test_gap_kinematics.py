"""Rotations that the attitude is made of."""

from __future__ import annotations

import numpy as np
import scipy

from mavcompass.frames import matrix_to_rotvec, rotvec_to_matrix


def test_rotvec_to_matrix_are_scipys_rotations_and_their_vectors_come_back() -> None:
    vectors = np.random.default_rng(4).uniform(-1.5, 1.5, (200, 3))
    vectors[:3] = [[0.0, 0.0, 0.0], [1e-12, 0.0, 0.0], [1e-5, -1e-5, 0.0]]
    rotations = rotvec_to_matrix(vectors)
    theirs = scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotations, theirs, atol=1e-12)
    np.testing.assert_allclose(matrix_to_rotvec(rotations), vectors, atol=1e-9)
