"""Rotations, written once more so that an error elsewhere cannot hide here.

A rotation C of shape (3, 3) takes body vectors (FRD) to the world (NED). Columns of C are therefore the
body's axes in the world.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def from_angles(roll_rad: Array, pitch_rad: Array, yaw_rad: Array) -> Array:
    """Build rotations (N, 3, 3): turn about down, then the new right, then the new forward axis."""
    yaw = _about(2, yaw_rad)
    pitch = _about(1, pitch_rad)
    roll = _about(0, roll_rad)
    return yaw @ pitch @ roll


def _about(axis: int, angle_rad: Array) -> Array:
    angle = np.atleast_1d(np.asarray(angle_rad, dtype=np.float64))
    out = np.zeros((angle.size, 3, 3))
    one, two = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, one, one] = out[:, two, two] = np.cos(angle)
    out[:, two, one] = np.sin(angle)
    out[:, one, two] = -np.sin(angle)
    return out


def from_thrust(thrust_ned: Array, yaw_rad: Array) -> Array:
    """Build rotations (N, 3, 3) with down against a thrust (N, 3) and the nose toward a yaw (N,)."""
    down = -thrust_ned / np.linalg.norm(thrust_ned, axis=1, keepdims=True)
    level = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)], axis=1)
    right = np.cross(down, level)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([np.cross(right, down), right, down], axis=2)


def from_vector(vector_rad: Array) -> Array:
    """Build the rotations (..., 3, 3) about vectors (..., 3) by their lengths (Rodrigues)."""
    vector = np.asarray(vector_rad, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = np.zeros((*vector.shape[:-1], 3, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = (vector[..., i] for i in range(3))
    cross = cross - np.swapaxes(cross, -1, -2)
    half = np.sinc(angle / (2.0 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross)


def to_body(rotation: Array, world: Array) -> Array:
    """Express world vectors (N, 3) or one vector (3,) in the axes of the bodies (N, 3, 3)."""
    return np.asarray((np.broadcast_to(world, (len(rotation), 3))[:, None, :] @ rotation)[:, 0])


def angles(rotation: Array) -> Array:
    """Read roll, pitch and yaw (N, 3) off rotations (N, 3, 3)."""
    forward, right_down, down_down = rotation[:, :, 0], rotation[:, 2, 1], rotation[:, 2, 2]
    pitch = -np.arcsin(np.clip(forward[:, 2], -1.0, 1.0))
    return np.stack(
        [np.arctan2(right_down, down_down), pitch, np.arctan2(forward[:, 1], forward[:, 0])], axis=1
    )


def quaternions(rotation: Array) -> Array:
    """Turn rotations (N, 3, 3) into unit quaternions (N, 4), scalar first and not negative."""
    c = rotation
    # Each column holds the four products of one component with all; the largest diagonal is the safe one.
    products = np.empty((len(c), 4, 4))
    products[:, 0, 0] = 1.0 + c[:, 0, 0] + c[:, 1, 1] + c[:, 2, 2]
    products[:, 1, 1] = 1.0 + c[:, 0, 0] - c[:, 1, 1] - c[:, 2, 2]
    products[:, 2, 2] = 1.0 - c[:, 0, 0] + c[:, 1, 1] - c[:, 2, 2]
    products[:, 3, 3] = 1.0 - c[:, 0, 0] - c[:, 1, 1] + c[:, 2, 2]
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        products[:, 0, axis + 1] = products[:, axis + 1, 0] = c[:, two, one] - c[:, one, two]
        products[:, one + 1, two + 1] = products[:, two + 1, one + 1] = c[:, one, two] + c[:, two, one]
    best = np.argmax(np.einsum("nii->ni", products), axis=1)
    q = products[np.arange(len(c)), best]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0.0, -q, q)


def from_quaternions(quaternion: Array) -> Array:
    """Turn unit quaternions (N, 4), scalar first, into rotations (N, 3, 3)."""
    scalar, vector = quaternion[:, 0, None, None], quaternion[:, 1:]
    cross = np.zeros((len(quaternion), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = vector.T
    cross = cross - np.swapaxes(cross, 1, 2)
    return np.eye(3) + 2.0 * scalar * cross + 2.0 * cross @ cross


def body_rates(rotation: Array, step_s: float) -> Array:
    """Differentiate rotations (N, 3, 3) at equal steps: the angular rate (N, 3) in body axes, rad/s."""
    between = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    skew = 0.5 * (between - np.swapaxes(between, 1, 2))
    sine_vector = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(sine_vector, axis=1, keepdims=True)
    cosine = 0.5 * (np.einsum("nii->n", between) - 1.0)[:, None]
    angle = np.arctan2(sine, cosine)
    middle = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0) * sine_vector / step_s
    padded = np.concatenate([middle[:1], middle, middle[-1:]])
    return 0.5 * (padded[:-1] + padded[1:])
