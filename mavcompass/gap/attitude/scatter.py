"""How sampled readings scatter: what is white in them, and a gyro's bias at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.tables import usual

# Readings of a window that a spectrum is taken of, and frequencies that a window spreads a constant over.
_WINDOW, _WINDOWED = 32, 3
# The median of squares of normal deviates.
MEDIAN_OF_SQUARES = 0.455


def white_floor(values: FloatArray) -> FloatArray:
    """Return the standard deviation of what is white in columns (N, k), (k,): the floor of their spectrum.

    The lower quartile over frequencies of the median over Hann windows (Welch 1967). A vehicle that rocks or
    shakes does so in a band, which may lie at the end of the spectrum, where differences look.
    """
    size = min(_WINDOW, len(values))
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size) ** 2
    window /= math.sqrt(float(window @ window))
    starts = np.arange(0, len(values) - size + 1, max(size // 2, 1))
    pieces = values[starts[:, None] + np.arange(size)]
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * window[:, None]
    power = np.median(np.abs(np.fft.rfft(pieces, axis=1)) ** 2, axis=0) / math.log(2.0)
    # The window spreads a constant and a slow turn over the lowest ones.
    return np.asarray(np.sqrt(np.quantile(power[_WINDOWED : size // 2], 0.25, axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class Bias:
    """Hold a sensor's bias and its standard deviation, (3,) each, in the sensor's unit."""

    mean: FloatArray
    sigma: FloatArray


def bias_at_rest(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> Bias:
    """Return the bias (3,) that the stretches at rest show; wide about zero where nothing rests.

    Parts of a rest differ by what still moves (a hovering copter drifts about): that is its sigma.
    """
    parts = [
        rate[rows].mean(axis=0) for stretch in rests(clock, rate, acc) for rows in _parts(clock, stretch)
    ]
    if not parts:
        return Bias(np.zeros(3), np.full(3, usual.gyro.unknown_bias_radps))
    if len(parts) < usual.rest.fewest_parts:
        return Bias(np.mean(parts, axis=0), np.full(3, usual.gyro.unknown_bias_radps))
    # Slow motion makes neighbouring parts alike: two of them count as one.
    spread = np.std(parts, axis=0, ddof=1) / math.sqrt(0.5 * len(parts))
    return Bias(np.median(parts, axis=0), np.maximum(spread, usual.gyro.least_bias_radps))


def rests(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> list[slice]:
    """Return the stretches of some seconds in which neither gyro nor accelerometer changes."""
    still = _still(clock, rate, acc)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    found = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [s for s in found if clock[s.stop - 1] - clock[s.start] >= usual.rest.shortest_s]


def _parts(clock: FloatArray, stretch: slice) -> list[slice]:
    count = max(int((clock[stretch.stop - 1] - clock[stretch.start]) / usual.rest.part_s), 1)
    edges = np.linspace(stretch.start, stretch.stop, count + 1).round().astype(np.int64)
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]


def _still(clock: FloatArray, rate: FloatArray, acc: FloatArray) -> NDArray[np.bool_]:
    width = max(3, int(usual.rest.smoothing_s / max(float(np.median(np.diff(clock))), 1e-3)))
    smooth, force = smoothed(rate, width), smoothed(acc, width)
    slow = np.abs(smooth).max(axis=1) < usual.rest.largest_radps
    if not slow.any():
        return slow
    # The quietest stretch tells the bias; whatever turns no faster than that is still.
    size = np.where(slow, np.abs(smooth).max(axis=1), np.inf)
    bias = np.median(smooth[size <= size.min() + usual.rest.same_radps], axis=0)
    still = slow & (np.abs(smooth - bias).max(axis=1) < usual.rest.same_radps)
    change = np.zeros(clock.size)
    change[width:] = np.abs(force[width:] - force[:-width]).max(axis=1)
    return np.asarray(still & (change < usual.rest.same_mps2))


def smoothed(values: FloatArray, width: int) -> FloatArray:
    """Return centred means of columns (N, 3) over some rows; beyond the ends is nothing."""
    kernel = np.ones(width) / width
    return np.stack([np.convolve(values[:, i], kernel, mode="same") for i in range(3)], axis=1)
