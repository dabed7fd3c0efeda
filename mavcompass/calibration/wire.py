"""What a whole-number wire does to an average, and how to take it back.

MAVLink's RAW_IMU and SCALED_IMU carry the field as int16 milligauss. ArduPilot makes the whole number
by C's conversion, which cuts toward zero, so an average comes out half a step too small; other
recordings round. Both hide the average inside a step unless noise moves the readings across it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.frames import FloatArray

_UNIFORM_SD = 1.0 / math.sqrt(12.0)
# A noise-free reading of 0 after truncation may be anything in (-1, 1).
_ZERO_CELL_SD = 1.0 / math.sqrt(3.0)


def unquantise(
    mean: ArrayLike, spread: ArrayLike, quantum: float, truncated: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Estimate the average before whole-number conversion.

    Args:
        mean: averages of the converted readings, any shape.
        spread: standard deviation of single converted readings, same shape.
        quantum: the step; 0 means the readings are not quantised.
        truncated: True for cutting toward zero, False for rounding.

    Returns:
        The estimated average, the standard deviation that the conversion leaves on it (it does not
        shrink with more readings), and the noise of single readings without the conversion's share.

    With noise of s steps the conversion's error has the amplitude exp(-2 pi^2 s^2) / pi of its first
    harmonic; cutting toward zero takes erf(v / (s sqrt 2)) / 2 steps from an average v.
    """
    average = np.asarray(mean, dtype=np.float64)
    sd = np.asarray(spread, dtype=np.float64)
    if quantum <= 0.0:
        return average, np.zeros_like(average), sd
    from scipy.special import erf

    m = average / quantum
    noise = np.sqrt(np.maximum((sd / quantum) ** 2 - _UNIFORM_SD**2, 0.0))
    hidden = np.exp(-2.0 * (math.pi * noise) ** 2)
    sigma = _UNIFORM_SD * hidden
    if truncated:
        width = math.sqrt(2.0) * np.maximum(noise, 0.5)
        value = m
        for _ in range(8):
            value = m + 0.5 * erf(value / width)
        sigma = np.where(np.abs(m) < 0.5, _ZERO_CELL_SD * hidden, sigma)
    else:
        value = m
    return value * quantum, sigma * quantum, noise * quantum


def effective_count(values: FloatArray) -> tuple[NDArray[np.bool_], int]:
    """Find the fresh readings among repeated ones.

    ArduPilot reads the compass at 10 Hz and repeats the value in RAW_IMU at the streamed rate.
    Returns a mask (N,) of the readings that differ from the one before, and their number.
    """
    fresh = np.ones(len(values), dtype=bool)
    if len(values) > 1:
        fresh[1:] = np.any(values[1:] != values[:-1], axis=1)
    return fresh, int(fresh.sum())
