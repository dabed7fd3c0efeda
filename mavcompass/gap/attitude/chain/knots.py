"""At which times a smoother has states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# So far apart at least, and no more of them than this.
KNOT_S, _MOST_KNOTS, _FEWEST_KNOTS = 0.4, 600, 8
_SILENCE = 2.5


def silences(clock: FloatArray) -> NDArray[np.bool_]:
    """Tell which of the steps between times (N,) are far longer than usual, (N - 1,)."""
    step = np.diff(clock)
    return np.asarray(step > _SILENCE * np.median(step))


def knots_of(clock: FloatArray) -> FloatArray:
    """Return even knots, with one on each side of every silence and none in it."""
    span = float(clock[-1] - clock[0])
    count = max(round(span / max(KNOT_S, span / _MOST_KNOTS)), _FEWEST_KNOTS) + 1
    even = np.linspace(clock[0], clock[-1], count)
    silent = np.flatnonzero(silences(clock))
    first, last = clock[silent], clock[silent + 1]
    # Not beside an edge either: neighbours must not be too alike.
    near = 0.25 * (even[1] - even[0])
    for begin, end in zip(first, last, strict=True):
        even = even[(even < begin - near) | (even > end + near)]
    return np.unique(np.concatenate([clock[:1], even, first, last, clock[-1:]]))
