"""What a whole-number wire does to an average, and how to take it back.

MAVLink's RAW_IMU and SCALED_IMU carry the field as int16 milligauss. ArduPilot makes the whole number
by C's conversion, which cuts toward zero, so an average comes out half a step too small; other
recordings round. Both hide the average inside a step unless noise moves the readings across it.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.frames import FloatArray

# A noise-free reading of 0 after truncation may be anything in (-1, 1).
_ZERO_CELL_SD = 1.0 / math.sqrt(3.0)
# Noise is told by means over this time.
_MEAN_S = 0.025
_HARMONICS = np.arange(1, 9)
_NOISE_GRID = np.linspace(0.0, 1.0, 101)


def unquantise(
    mean: ArrayLike, spread: ArrayLike, quantum: float, truncated: bool
) -> tuple[FloatArray, FloatArray]:
    """Estimate averages before whole-number conversion.

    Args:
        mean: averages of the converted readings, one per axis, (k,).
        spread: standard deviation of single converted readings, (k,); the axes share one noise.
        quantum: the step; 0 means the readings are not quantised.
        truncated: True for cutting toward zero, False for rounding.

    Returns:
        The estimated averages and the standard deviation that the conversion leaves on each (it does
        not shrink with more readings), both (k,).

    With noise of s steps the conversion's error, over all places of the average in a step, has the
    variance sum_k exp(-4 pi^2 k^2 s^2) / (2 pi^2 k^2): 1/12 without noise, nothing from s = 0.6 on.
    Cutting toward zero takes erf(v / (s sqrt 2)) / 2 steps from an average v.
    """
    average = np.asarray(mean, dtype=np.float64)
    if quantum <= 0.0:
        return average, np.zeros_like(average)
    m = average / quantum
    noise = _noise_before(float(np.mean((np.asarray(spread, dtype=np.float64) / quantum) ** 2)))
    hidden = math.sqrt(_hidden_variance(noise))
    sigma = np.full_like(average, hidden)
    value = m
    if truncated:
        width = math.sqrt(2.0) * max(noise, 0.5)
        for _ in range(8):
            value = m + 0.5 * _erf(value / width)
        zero_cell = hidden * math.sqrt(12.0) * _ZERO_CELL_SD
        sigma = np.where(np.abs(m) < 0.5, zero_cell, sigma)
    return value * quantum, sigma * quantum


def _erf(values: FloatArray) -> FloatArray:
    # scipy has it for arrays, and takes half a second to load: while a vehicle stands still and waits.
    return np.array([math.erf(v) for v in values.ravel().tolist()]).reshape(values.shape)


def hidden_in_runs(values: FloatArray, first: NDArray[np.intp], quantum: float) -> FloatArray:
    """Return what whole numbers hide of averages, 1 sigma of each axis, (K, 3).

    Args:
        values: converted readings, (N, 3). first: where each average begins, (K,), the first at 0.
        quantum: the step; 0 means the readings are not quantised.

    A run of one value hides a twelfth of a square step, and the next run another: noise makes the runs
    short, and so does a field that moves through the steps, on the axes along which it moves.
    """
    if quantum <= 0.0 or not len(first):
        return np.zeros((len(first), 3))
    last = np.append(first[1:], len(values))
    new = np.ones(values.shape, dtype=bool)
    new[1:] = values[1:] != values[:-1]
    new[first] = True
    share = np.zeros((len(first), 3))
    for axis in range(3):
        begins = np.flatnonzero(new[:, axis])
        squares = np.diff(begins, append=len(values)) ** 2.0
        share[:, axis] = np.add.reduceat(squares, np.searchsorted(begins, first))
    return np.asarray(quantum * np.sqrt(share / 12.0) / (last - first)[:, np.newaxis])


def _hidden_variance(noise: float) -> float:
    """Return the conversion's variance of an average, in steps squared, for a noise in steps."""
    k2 = _HARMONICS**2
    tail = 1.0 / 12.0 - float((1.0 / (2.0 * math.pi**2 * k2)).sum())  # only counts without noise
    terms = np.exp(-4.0 * (math.pi * noise) ** 2 * k2) / (2.0 * math.pi**2 * k2)
    return float(terms.sum()) + (tail if noise < 0.01 else 0.0)


def _noise_before(variance: float) -> float:
    """Return the noise in steps whose converted readings vary that much, over all places in a step.

    The converted readings' variance is s^2 + 1/12 less what is hidden from it.
    """
    if variance > 1.0:
        return math.sqrt(variance - 1.0 / 12.0)
    return float(np.interp(variance, _seen_variances(), _NOISE_GRID))


@cache
def _seen_variances() -> FloatArray:
    return np.array([s * s + 1.0 / 12.0 - _hidden_variance(float(s)) for s in _NOISE_GRID])


def fresh_readings(values: FloatArray) -> NDArray[np.bool_]:
    """Mark the readings that differ from the one before, (N,).

    ArduPilot reads the compass at 10 Hz and repeats the value in RAW_IMU at the streamed rate.
    """
    fresh = np.ones(len(values), dtype=bool)
    fresh[1:] = np.any(values[1:] != values[:-1], axis=1)
    return fresh


def white_noise(time: FloatArray, values: FloatArray, quantile: float = 0.5) -> FloatArray:
    """Return each axis's noise of one of (N, M) samples, as far as it adds up like white noise: (M,).

    By second differences, which smooth motion hardly shows, and of means: a filter ahead of a fast recording
    takes noise out of the difference of neighbours and leaves it in their sum. `quantile` of the differences
    tells; a smaller one looks at the calmer part of a motion.
    """
    interval_s = max(float(np.median(np.diff(time))), 1e-6)
    count = max(min(round(_MEAN_S / interval_s), len(values) // 8), 1)
    whole = len(values) // count
    means = values[: whole * count].reshape(whole, count, -1).mean(axis=1)
    bends = np.quantile(np.abs(np.diff(means, 2, axis=0)), quantile, axis=0)
    normal = NormalDist().inv_cdf(0.5 + 0.5 * quantile)
    return np.asarray(bends / normal * math.sqrt(count / 6.0) + 1e-9)
