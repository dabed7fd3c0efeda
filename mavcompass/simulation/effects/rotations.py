"""Rotations by small vectors, used by several effects."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray


def skew(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that takes v to vector x v."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_vector_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) by |vector| radians about the vector (Rodrigues' formula)."""
    angle = math.sqrt(float(vector @ vector))
    k = skew(vector)
    if angle < 1e-9:
        return np.eye(3) + k
    return np.eye(3) + math.sin(angle) / angle * k + (1.0 - math.cos(angle)) / angle**2 * (k @ k)
