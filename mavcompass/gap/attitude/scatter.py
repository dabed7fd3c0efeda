"""How sampled readings scatter: what is white in them, and what lies between them."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray

# The order of the differences that noise is told from.
_ORDER = 6
# Readings of a window that a spectrum is taken of, and frequencies that a window spreads a constant over.
_WINDOW, _WINDOWED = 32, 3
# The share of a fourth difference that an integral misses between samples, and beyond which multiple of the
# usual square it does; the median of squares of normal deviates.
_MISSED, _FAR_OUT = 0.1, 6.0
MEDIAN_OF_SQUARES = 0.455


def white_scatter(values: FloatArray) -> FloatArray:
    """Return the standard deviation of what is white in columns (N, k), (k,), from sixth differences.

    Those of white noise have the variance C(12, 6) sigma^2. Of a motion of frequency f, sampled every h
    seconds, they hold (2 sin(pi f h))^6 only: second ones took a vehicle's own swinging for noise.
    """
    sixth = np.abs(np.diff(values, _ORDER, axis=0))
    return np.asarray(1.4826 * np.median(sixth, axis=0) / math.sqrt(math.comb(2 * _ORDER, _ORDER)))


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


def missed_between(clock: FloatArray, values: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the variances of what integrals of values (N, 3) miss between knots (K,), (K - 1, 3), where the
    values change within a few samples.

    What is sampled often enough has small fourth differences. A vehicle that rocks all the time is missed as
    often one way as the other: only what stands out of the usual counts.
    """
    each_s = float(np.median(np.diff(clock)))
    square = np.zeros_like(values)
    square[2:-2] = np.diff(values, 4, axis=0) ** 2
    usual = np.median(square, axis=0) / MEDIAN_OF_SQUARES
    missed = (_MISSED * each_s) ** 2 * np.where(square > _FAR_OUT * usual, square, 0.0)
    steps = len(knots) - 1
    within = np.clip(np.searchsorted(knots, clock, side="right") - 1, 0, steps - 1)
    return np.stack([np.bincount(within, one, minlength=steps) for one in missed.T], axis=1)
