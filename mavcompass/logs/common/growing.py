"""Arrays that grow at their end without being copied."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# What is not yet filled is kept in memory as zeros, so a large array grows in smaller steps.
_GROWTH, _LARGE_GROWTH = 1.5, 1.1
_LARGE_ROWS = 1 << 17


class GrowingArray:
    """Collect rows of one type, of which nobody knows beforehand how many will come.

    A large block grows by the system's remapping of its pages; a list of parts would need everything
    twice when it is joined.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._array = np.empty(0, dtype=dtype)
        self._filled = 0

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, (N,)."""
        end = self._filled + rows.size
        if end > self._array.size:
            # Nobody else holds the array before `finish`, so no reference needs to be checked.
            growth = _GROWTH if end < _LARGE_ROWS else _LARGE_GROWTH
            self._array.resize(max(end, int(end * growth) if self._filled else 0), refcheck=False)
        self._array[self._filled : end] = rows
        self._filled = end

    def finish(self) -> NDArray[Any]:
        """Return what was collected; nothing may be appended afterwards."""
        self._array.resize(self._filled, refcheck=False)
        return self._array
