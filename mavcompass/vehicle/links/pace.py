"""Virtual time beside the wall clock."""

from __future__ import annotations

import time


class Pace:
    """Keep virtual time from running ahead of the wall clock; `speed` 2 is twice real time."""

    def __init__(self, speed: float, virtual_s: float) -> None:
        self._speed = speed
        self._virtual_s = virtual_s
        self._wall_s = time.monotonic()

    def virtual_now(self) -> float:
        """Return the virtual time that has been reached by now."""
        return self._virtual_s + (time.monotonic() - self._wall_s) * self._speed

    def sleep_until(self, virtual_s: float) -> None:
        """Wait for the wall clock."""
        ahead_s = (virtual_s - self.virtual_now()) / self._speed
        if ahead_s > 0.0:
            time.sleep(ahead_s)
