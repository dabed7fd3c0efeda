"""Signals at other times: cubic interpolation and a first-order low pass, exact between samples."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, cross
from mavcompass.simulation.physics.signals import Turning

# Rotations whose elements differ by less turn the Earth's field by half a milligauss.
_THE_SAME = 1e-3


@lru_cache(maxsize=8)
def _hermite(samples: bytes, wanted: bytes) -> tuple[NDArray[np.int64], FloatArray]:
    """Find wanted times (M,) among samples (N,), two at least, once for all columns that are late alike.

    A value of a cubic Hermite piece is the shares (M, 1, 4) of the neighbours at `left` (M,) and `left` + 1:
    of value and slope of the one, then of the other. Outside the ends are held.
    """
    time_s, wanted_s = np.frombuffer(samples), np.frombuffer(wanted)
    wanted_s = np.minimum(np.maximum(wanted_s, time_s[0]), time_s[-1])
    left = np.minimum(np.maximum(time_s.searchsorted(wanted_s, side="right") - 1, 0), time_s.size - 2)
    width = time_s[left + 1] - time_s[left]
    u = (wanted_s - time_s[left]) / width
    rise = u * u * (3.0 - 2.0 * u)
    slope = width * u * (1.0 - u)
    return left, np.stack([1.0 - rise, slope * (1.0 - u), rise, -slope * u], axis=1)[:, None]


@lru_cache(maxsize=8)
def _catmull_rom(samples: bytes, wanted: bytes) -> tuple[NDArray[np.int64], FloatArray]:
    """Do so with central differences for slopes: return four neighbours and their shares, (M, 4) each."""
    time_s = np.frombuffer(samples)
    left, shares = _hermite(samples, wanted)
    before, after = np.maximum(left - 1, 0), np.minimum(left + 2, time_s.size - 1)
    at_left, of_left, at_right, of_right = shares[:, 0].T
    of_left = of_left / (time_s[left + 1] - time_s[before])
    of_right = of_right / (time_s[after] - time_s[left])
    neighbours = np.stack([before, left, left + 1, after], axis=1)
    return neighbours, np.stack([-of_left, at_left - of_right, at_right + of_left, of_right], axis=1)[:, None]


def at_times(
    time_s: FloatArray, values: FloatArray, wanted_s: FloatArray, slopes: FloatArray | None = None
) -> FloatArray:
    """Interpolate columns (N, k) by cubic Hermite pieces; outside the ends are held.

    Without `slopes` (N, k) these are central differences (Catmull and Rom), which reproduces parabolas
    exactly.
    """
    if slopes is not None:
        return _along(time_s, np.stack([values, slopes], axis=1), wanted_s)
    if time_s.size < 2:
        return np.repeat(values[:1], wanted_s.size, axis=0)
    neighbours, shares = _catmull_rom(time_s.tobytes(), wanted_s.tobytes())
    return np.asarray(np.matmul(shares, values.take(neighbours, axis=0))[:, 0])


def _along(time_s: FloatArray, values_and_slopes: FloatArray, wanted_s: FloatArray) -> FloatArray:
    """Interpolate columns (N, 2, k) of values and their slopes."""
    if time_s.size < 2:
        return np.repeat(values_and_slopes[:1, 0], wanted_s.size, axis=0)
    left, shares = _hermite(time_s.tobytes(), wanted_s.tobytes())
    both = values_and_slopes.take(left[:, None] + np.arange(2), axis=0).reshape(wanted_s.size, 4, -1)
    return np.asarray(np.matmul(shares, both)[:, 0])


def rotation_at(turning: Turning, wanted_s: FloatArray, time_constant_s: float = 0.0) -> FloatArray:
    """Return rotations (N, 3, 3) at other times, or what a first-order low pass makes of them.

    What is left of their length is the interpolation's, or the smoothing's.
    """
    both = _with_slopes(turning)
    if time_constant_s:
        flat = smoothed_at(turning.time_s, both[:, 0], wanted_s, both[:, 1], time_constant_s)
    else:
        flat = _along(turning.time_s, both, wanted_s)
    return flat.reshape(-1, 3, 3)


def thinned(turning: Turning) -> Turning:
    """Leave samples out, three of four or fewer, between which the others and their rates tell the same."""
    for every in (4, 3, 2):
        some = np.append(np.arange(0, turning.time_s.size - 1, every), turning.time_s.size - 1)
        fewer = replace(
            turning,
            time_s=turning.time_s[some],
            rotation=turning.rotation[some],
            rate_radps=turning.rate_radps[some],
        )
        if float(np.abs(rotation_at(fewer, turning.time_s) - turning.rotation).max()) < _THE_SAME:
            return fewer
    return turning


@lru_cache(maxsize=2)
def _with_slopes(turning: Turning) -> FloatArray:
    """Return rotations and their slopes, (M, 2, 9): a row of R has its product with the rate as slope."""
    rows = turning.rotation.transpose(1, 0, 2)
    slopes = np.concatenate([cross(row, turning.rate_radps) for row in rows], axis=1)
    return np.stack([turning.rotation.reshape(-1, 9), slopes], axis=1)


def smoothed_at(
    time_s: FloatArray,
    values: FloatArray,
    wanted_s: FloatArray,
    slopes: FloatArray,
    time_constant_s: float,
) -> FloatArray:
    """Low-pass columns (N, k) with tau dy/dt + y = x and return them at wanted times, (M, k).

    Exact for x of cubic Hermite pieces. It starts settled on its first sample; outside the ends are held.
    """
    if time_s.size < 2:
        return at_times(time_s, values, wanted_s, slopes)
    tau, width = max(time_constant_s, 1e-9), np.diff(time_s)[:, None]
    rise = np.diff(values, axis=0) / width
    second = 2.0 * (3.0 * rise - 2.0 * slopes[:-1] - slopes[1:]) / width
    third = 6.0 * (slopes[:-1] + slopes[1:] - 2.0 * rise) / width**2
    # Where it has forgotten how it began, y is x - tau dx + tau^2 d2x - tau^3 d3x, piece by piece.
    steepness = slopes[:-1] - tau * (second - tau * third)
    settled = values[:-1] - tau * steepness

    def within(piece: NDArray[np.int64] | slice, u: FloatArray) -> FloatArray:
        """Return that at `u` seconds into pieces."""
        bend = (second[piece] - tau * third[piece]) / 2.0 + u * third[piece] / 6.0
        return np.asarray(settled[piece] + u * (steepness[piece] + u * bend))

    decay = np.exp(-width / tau)
    drive = np.concatenate([values[:1], within(slice(None), width) - decay * settled])
    out = _recursion(np.concatenate([[0.0], decay[:, 0]]), drive)
    wanted = np.minimum(np.maximum(wanted_s, time_s[0]), time_s[-1])
    left = np.minimum(np.maximum(time_s.searchsorted(wanted, side="right") - 1, 0), time_s.size - 2)
    u = (wanted - time_s[left])[:, None]
    return within(left, u) + np.exp(-u / tau) * (out[left] - settled[left])


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


def or_zero(values: FloatArray) -> FloatArray:
    """Return values with zeros where nothing is known."""
    return np.where(np.isnan(values), 0.0, values)


def spread(values: FloatArray) -> FloatArray:
    """Return the standard deviation of columns (N, ...) without what is missing; 0 where nothing is left."""
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, values, 0.0).sum(axis=0) / count
    return np.asarray(np.sqrt(np.square(np.where(known, values - mean, 0.0)).sum(axis=0) / count))
