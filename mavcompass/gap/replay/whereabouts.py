"""How far a receiver's places may be off, and how that wanders: what belongs to a place is found by them.

A receiver tells velocities of its own, from the Doppler shift. What its places move against the way that
these make is a bound of their wander, an Ornstein-Uhlenbeck process with the memory of the atmosphere's
delays.
"""

from __future__ import annotations

import math

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude import Reference, integral, local_position
from mavcompass.gap.attitude.scatter import white_scatter
from mavcompass.track import Series, Track

_MEMORY_S = 60.0
# How long places are compared with the way of the velocities, whose own errors would take over.
_SPAN_S = 5.0
_FEWEST_FIXES = 60
_LEAST_M, _MOST_M = 0.05, 3.0
# Standard deviations of a path beside which the errors of a position are small.
_LEAST_PATH_M, _LEAST_RECEIVED_PATH_M = 0.05, 1.5
_LEAST_TOLD_PATH_M, _BEYOND_WANDER = 0.5, 3.0


def place_scatter_m(position_m: Series | None) -> FloatArray:
    """Return how far neighbouring places scatter by themselves, (3,), metres; zero where nothing tells."""
    if position_m is None or len(position_m) < _FEWEST_FIXES or not np.isfinite(position_m.values).all():
        return np.zeros(3)
    return white_scatter(position_m.values)


def wander_m(position_m: Series | None, velocity_mps: Series | None) -> FloatArray | None:
    """Return how far places may wander, (3,), metres; None where nothing tells."""
    if position_m is None or velocity_mps is None:
        return None
    known = np.isfinite(velocity_mps.values).all(axis=1)
    time_s = velocity_mps.time_s[known]
    if known.sum() < _FEWEST_FIXES or not np.isfinite(position_m.values).all():
        return None
    way = position_m.at(time_s) - integral(time_s, velocity_mps.values[known])
    later = np.searchsorted(time_s, time_s + _SPAN_S)
    pairs = np.flatnonzero(later < time_s.size)
    if not pairs.size:
        return None
    moved = way[later[pairs]] - way[pairs]
    square = (1.4826 * np.median(np.abs(moved), axis=0)) ** 2 - 2.0 * white_scatter(way) ** 2
    sigma = np.sqrt(np.maximum(square, 0.0) / (2.0 * (1.0 - math.exp(-_SPAN_S / _MEMORY_S))))
    return np.asarray(np.where(sigma < _LEAST_M, 0.0, np.minimum(sigma, _MOST_M)))


def position_of(track: Track, reference: Reference) -> Series | None:
    """Return the best position there is: measured, or the receiver's where the vehicle goes far enough."""
    measured = track.position_ned_m
    if measured is not None and len(measured) > 1:
        return measured
    received = local_position(track.place)
    return received if received is not None and goes_about(received, track, reference) else None


def goes_about(position: Series | None, track: Track, reference: Reference) -> bool:
    """Tell whether a path is longer than its errors, which an independent reference does not have.

    How far places wander is measured where a velocity is known besides.
    """
    if position is None or not np.isfinite(position.values).all(axis=1).any():
        return False
    spread = np.nanstd(position.values, axis=0)
    if reference.kind == "columns":
        return float(spread.max()) > _LEAST_PATH_M
    wander = wander_m(position, track.gps_velocity_mps)
    least = math.inf if wander is None else np.maximum(_BEYOND_WANDER * wander, _LEAST_TOLD_PATH_M)
    return bool((spread > np.minimum(least, _LEAST_RECEIVED_PATH_M)).any())
