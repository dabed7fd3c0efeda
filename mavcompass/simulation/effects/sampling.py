"""Signals at other times: cubic interpolation and a first-order low pass, exact between samples."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray


def at_times(
    time_s: FloatArray, values: FloatArray, wanted_s: FloatArray, slopes: FloatArray | None = None
) -> FloatArray:
    """Interpolate columns (N, k) by cubic Hermite pieces; outside the ends are held.

    Without `slopes` (N, k) these are central differences (Catmull and Rom), which reproduces parabolas
    exactly.
    """
    n = time_s.size
    if n < 2:
        return np.repeat(values[:1], wanted_s.size, axis=0)
    slopes = central_differences(time_s, values) if slopes is None else slopes
    wanted = np.minimum(np.maximum(wanted_s, time_s[0]), time_s[-1])
    left = np.minimum(np.maximum(time_s.searchsorted(wanted, side="right") - 1, 0), n - 2)
    right = left + 1
    width = time_s[right] - time_s[left]
    u = (wanted - time_s[left]) / width
    rise = u * u * (3.0 - 2.0 * u)
    out = values.take(left, axis=0) * (1.0 - rise)[:, None]
    out += values.take(right, axis=0) * rise[:, None]
    out += slopes.take(left, axis=0) * (width * u * (1.0 - u) ** 2)[:, None]
    out -= slopes.take(right, axis=0) * (width * u * u * (1.0 - u))[:, None]
    return np.asarray(out)


def central_differences(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return the slopes of columns (N, k) over their neighbours, at the ends over one."""
    n = time_s.size
    if n < 2:
        return np.zeros_like(values)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    return np.asarray((values[after] - values[before]) / (time_s[after] - time_s[before])[:, None])


State = tuple[float, FloatArray, FloatArray]


def first_order_lag(
    time_s: FloatArray, values: FloatArray, time_constant_s: float, state: State | None = None
) -> tuple[FloatArray, State]:
    """Low-pass columns (N, k) with tau dy/dt + y = x, x linear between samples (exact for such x).

    Returns the output and the state to give to the next block. It starts settled on its first sample.
    """
    first = np.asarray(values[0])
    last_time, x, y = state if state is not None else (float(time_s[0]), first, first)
    step = np.diff(time_s, prepend=last_time)
    ratio = step / max(time_constant_s, 1e-9)
    decay = np.exp(-ratio)
    mean = np.where(ratio > 1e-9, -np.expm1(-ratio) / np.where(ratio > 1e-9, ratio, 1.0), 1.0)
    before = np.vstack([x[None], values[:-1]])
    # y(t + h) = a y + (m - a) x(t) + (1 - m) x(t + h), a = exp(-h/tau), m = (1 - a) tau / h
    drive = (mean - decay)[:, None] * before + (1.0 - mean)[:, None] * values
    drive[0] += decay[0] * y
    out = _recursion(decay, drive)
    return out, (float(time_s[-1]), np.array(values[-1]), np.array(out[-1]))


def _recursion(decay: FloatArray, drive: FloatArray) -> FloatArray:
    """Return y_k = decay_k y_(k-1) + drive_k with y_0 = drive_0, by doubling the reach of each step."""
    out, factor = drive.copy(), decay.copy()
    factor[0] = 0.0
    reach = 1
    while reach < len(out) and float(factor.max()) > 1e-18:
        out[reach:] += factor[reach:, None] * out[:-reach].copy()
        factor[reach:] *= factor[:-reach].copy()
        factor[:reach] = 0.0
        reach *= 2
    return out


def spread(values: FloatArray) -> FloatArray:
    """Return the standard deviation of columns (N, ...) without what is missing; 0 where nothing is left."""
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, values, 0.0).sum(axis=0) / count
    return np.asarray(np.sqrt(np.square(np.where(known, values - mean, 0.0)).sum(axis=0) / count))
