"""Rotations from body rates: integrating a gyro."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix

_EVEN = 0.05


def integrated(clock: FloatArray, rate: FloatArray) -> FloatArray:
    """Integrate body rates (N, 3) to rotations (N, 3, 3) from the identity.

    Between two samples the rate is a cubic through four where these are evenly spaced, else a straight
    line. Rotations about changing axes do not add up: Magnus' second term, h^2 (w_1 x w_2) / 12.
    """
    step = np.diff(clock)
    mean = 0.5 * (rate[1:] + rate[:-1])
    even = np.abs(np.stack([step[:-2], step[2:]]) - step[1:-1]).max(axis=0) < _EVEN * step[1:-1]
    mean[1:-1] -= even[:, None] * (rate[3:] - rate[2:-1] - rate[1:-2] + rate[:-3]) / 24.0
    vectors = mean * step[:, None] + np.cross(rate[:-1], rate[1:]) * (step**2 / 12.0)[:, None]
    return products(exponentials(np.vstack([np.zeros((1, 3)), vectors])))


def products(rotations: FloatArray) -> FloatArray:
    """Return the products of the first 1, 2, ... of rotations (N, 3, 3)."""
    n = len(rotations)
    # Side by side in blocks first, then block after block.
    width = max(math.isqrt(n), 1)
    count = -(-n // width)
    out = np.concatenate([rotations, np.tile(np.eye(3), (count * width - n, 1, 1))])
    out = out.reshape(count, width, 3, 3)
    for j in range(1, width):
        out[:, j] = out[:, j - 1] @ out[:, j]
    for i in range(1, count):
        out[i] = out[i - 1, -1] @ out[i]
    return np.asarray(out.reshape(-1, 3, 3)[:n])


def exponentials(vectors: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) by rotation vectors (N, 3)."""
    angle = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    safe = np.where(angle > 1e-9, angle, 1.0)
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = vectors[:, 2], -vectors[:, 1], vectors[:, 0]
    first = np.where(angle > 1e-9, np.sin(safe) / safe, 1.0)[:, None, None]
    second = np.where(angle > 1e-9, (1.0 - np.cos(safe)) / safe**2, 0.5)[:, None, None]
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def with_down(clock: FloatArray, rate: FloatArray, down: FloatArray) -> FloatArray:
    """Build rotations with the given down vector (body axes) and the yaw that the rate integrates to."""
    roll = np.arctan2(down[:, 1], down[:, 2])
    pitch = np.arcsin(np.clip(-down[:, 0], -1.0, 1.0))
    cosine = np.maximum(np.cos(pitch), 0.05)
    yaw_rate = (rate[:, 1] * np.sin(roll) + rate[:, 2] * np.cos(roll)) / cosine
    if float(cosine.min()) > 0.3:
        middle = 0.5 * (yaw_rate[1:] + yaw_rate[:-1])
        yaw = np.concatenate([[0.0], np.cumsum(middle * np.diff(clock))])
        return euler_to_matrix(roll, pitch, yaw)
    return _without_euler(clock, rate, down)


def _without_euler(clock: FloatArray, rate: FloatArray, down: FloatArray) -> FloatArray:
    """Do the same where the vehicle points straight up: carry the whole attitude, then set its level."""
    step = np.diff(clock, prepend=clock[0])
    increments = exponentials(0.5 * (rate + np.vstack([rate[:1], rate[:-1]])) * step[:, None])
    rotation = euler_to_matrix(math.atan2(down[0, 1], down[0, 2]), math.asin(-float(down[0, 0])), 0.0)
    out = np.empty((clock.size, 3, 3))
    for i in range(clock.size):
        rotation = rotation @ increments[i]
        # The smallest rotation that takes the third row to the known down vector adds no yaw.
        x = rotation[0] - down[i] * float(rotation[0] @ down[i])
        x /= math.sqrt(float(x @ x))
        rotation = np.stack([x, np.cross(down[i], x), down[i]])
        out[i] = rotation
    return out
