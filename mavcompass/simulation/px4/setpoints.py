"""The stream of setpoints that PX4's OFFBOARD wants before the switch and as long as it lasts."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from mavcompass.simulation.autopilot import Board

# Setpoints must come faster than 2 Hz to be a stream.
_SLOWEST_S = 0.5


class Setpoints:
    """Note when setpoints came."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._heard_s: deque[float] = deque(maxlen=3)

    def forget(self) -> None:
        """Begin anew."""
        self._heard_s.clear()

    def heard(self) -> None:
        """Note one."""
        self._heard_s.append(self._board.boot_time_s)

    @property
    def flow(self) -> bool:
        """Tell whether setpoints have come, and come, as a stream."""
        gaps = [b - a for a, b in pairwise((*self._heard_s, self._board.boot_time_s))]
        return len(self._heard_s) == self._heard_s.maxlen and max(gaps) <= _SLOWEST_S

    @property
    def silent_s(self) -> float:
        """Return the time since the last one; infinite where none came."""
        return self._board.boot_time_s - self._heard_s[-1] if self._heard_s else math.inf
