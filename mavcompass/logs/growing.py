"""Arrays that grow at their end without being copied."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FIRST_ROWS = 1024
_GROWTH = 1.5


class GrowingArray:
    """Collect rows of one type, of which nobody knows beforehand how many will come.

    A large block grows by the system's remapping of its pages, and what is not yet filled takes no
    memory; a list of parts would need everything twice when it is joined.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._array = np.empty(_FIRST_ROWS, dtype=dtype)
        self._filled = 0

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, (N,)."""
        end = self._filled + rows.size
        if end > self._array.size:
            # Nobody else holds the array before `finish`, so no reference needs to be checked.
            self._array.resize(max(end, int(self._array.size * _GROWTH)), refcheck=False)
        self._array[self._filled : end] = rows
        self._filled = end

    def finish(self) -> NDArray[Any]:
        """Return what was collected; nothing may be appended afterwards."""
        self._array.resize(self._filled, refcheck=False)
        return self._array
