"""How far a yaw may wander that nothing but the compass itself tells."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray

# Autopilots without a baseline are seen to be off by ten to forty degrees for minutes, after a knock most of
# all. What changes faster is left to the compass: no turn of the vehicle is swallowed.
_WANDER_RAD, _LENGTH_S, _MOST_LENGTHS = math.radians(20.0), 20.0, 15.0
# Modes smaller than this are of no consequence.
_LEAST_RAD = math.radians(0.1)


def wandering_yaw(time_s: FloatArray) -> FloatArray:
    """Return how a yaw may wander at some times (N,): rotation vectors in world axes, radians, (N, 3, k).

    They are the modes of a smooth process, each with a standard normal amplitude: its covariance is the
    squared exponential (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, equation
    2.31).
    """
    span_s = float(time_s[-1] - time_s[0])
    # A long recording has no more modes than one of some minutes: they cost time.
    length_s = max(_LENGTH_S, span_s / _MOST_LENGTHS)
    count = max(math.ceil(2.0 * span_s / length_s), 3) + 1
    knots = np.linspace(time_s[0], time_s[-1], count)

    def covariance(at_s: FloatArray) -> FloatArray:
        """Return the covariance of the yaw at some times (M,) with that at the knots, (M, K)."""
        return np.asarray(_WANDER_RAD**2 * np.exp(-0.5 * ((at_s[:, None] - knots) / length_s) ** 2))

    values, vectors = np.linalg.eigh(covariance(knots))
    keep = np.flatnonzero(values > count * _LEAST_RAD**2)[::-1]
    # Between the knots the process is what it is expected to be beside them.
    curves = np.zeros((time_s.size, 3, keep.size))
    curves[:, 2] = covariance(time_s) @ vectors[:, keep] / np.sqrt(values[keep])
    return curves
