"""Rotations from body rates: integrating a gyro; and values at other times."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from mavcompass.frames import FloatArray, cross, euler_to_matrix, rotvec_to_matrix
from mavcompass.simulation.effects.sampling import at_times

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
    return products(rotvec_to_matrix(np.vstack([np.zeros((1, 3)), vectors])))


def integral(clock: FloatArray, values: FloatArray) -> FloatArray:
    """Integrate columns (N, k) from the first time on, by trapezia: (N, k)."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(clock)[:, None]
    return np.vstack([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])


def interpolated(clock: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Interpolate columns (N, k) linearly to other times (M,); outside the ends are held."""
    return np.stack([np.interp(time_s, clock, column) for column in values.T], axis=1)


def averaged(values: FloatArray, width: int, straight: bool = False) -> FloatArray:
    """Return centred running means of columns (N, k) over an odd number of rows; beyond the ends values are
    held, or go on `straight`."""
    half = min(width // 2, len(values) - 1)
    pad = partial(np.pad, values, ((half, half), (0, 0)))
    padded = pad(mode="reflect", reflect_type="odd") if straight else pad(mode="edge")
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(padded, axis=0)])
    return np.asarray((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1))


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


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices (N, 3, 3) that take the cross product of vectors (N, 3) with others."""
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = vectors[:, 2], -vectors[:, 1], vectors[:, 0]
    return k


def with_down(clock: FloatArray, rate: FloatArray, down: FloatArray) -> FloatArray:
    """Build rotations with the given down vector (N, 3, body axes), turning about it as the rate does.

    In the gyro's own still axes the known down vector wanders a little; the axes are carried after it by the
    smallest rotations, which add no yaw (parallel transport).
    """
    still = integrated(clock, rate)
    path = np.einsum("nij,nj->ni", still, down)
    # The cross product of neighbours is the rotation vector between them, but for the third power of its
    # size.
    steps = np.vstack([np.zeros((1, 3)), cross(path[:-1], path[1:])])
    back = products(rotvec_to_matrix(-steps))
    level = euler_to_matrix(
        math.atan2(down[0, 1], down[0, 2]), math.asin(float(np.clip(-down[0, 0], -1.0, 1.0))), 0.0
    )
    rotation = level @ still[0].T @ back @ still
    # What the third power left: set down exactly.
    ahead = rotation[:, 0] - down * np.einsum("ni,ni->n", rotation[:, 0], down)[:, None]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack([ahead, cross(down, ahead), down], axis=1)


def carried(clock: FloatArray, rotation: FloatArray, rate: FloatArray, time_s: FloatArray) -> FloatArray:
    """Carry rotations (N, 3, 3) to other times with the rates (N, 3) from the sample before."""
    left = np.clip(np.searchsorted(clock, time_s, side="right") - 1, 0, clock.size - 1)
    middle_rate = at_times(clock, rate, 0.5 * (time_s + clock[left]))
    return np.asarray(rotation[left] @ rotvec_to_matrix(middle_rate * (time_s - clock[left])[:, None]))
