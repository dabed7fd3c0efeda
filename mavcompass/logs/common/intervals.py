"""Small things about stretches of a byte array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.intp]


def windows(data: NDArray[np.uint8], starts: IntArray, width: int) -> NDArray[np.uint8]:
    """Copy `width` bytes from each start: shape (N, width)."""
    return np.lib.stride_tricks.sliding_window_view(data, width)[starts]


def not_overlapping(starts: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Of sorted stretches keep those that do not begin inside an earlier kept one."""
    keep = np.ones(starts.size, dtype=bool)
    # Only those that begin inside any earlier one can be in question.
    for index in (np.flatnonzero(starts[1:] < np.maximum.accumulate(ends)[:-1]) + 1).tolist():
        before = index - 1
        while not keep[before]:
            before -= 1
        keep[index] = starts[index] >= ends[before]
    return keep
