"""ArduPilot's own compass calibration, as far as a vehicle on level ground gets with it.

It wants 300 readings spread over the whole sphere, each at least 6.3 degrees from all others. A turn
on the level yields at most 57 of them, so it never ends by itself.
"""

from __future__ import annotations

import math

from mavcompass.enums import MagCalStatus
from mavcompass.messages import MagCalProgress

_SAMPLES = 300
_SPACING_RAD = math.radians(6.3)
_STEP_ONE_PCT = 33.3


class MagnetometerCalibration:
    """Hold the state of DO_START_MAG_CAL."""

    def __init__(self) -> None:
        self._headings: set[int] = set()
        self.reset()

    def reset(self) -> None:
        """Forget all, as a power-up does."""
        self.running = False
        self.reboot_wanted = False
        self._mask = 0
        self._headings.clear()

    def start(self, mask: int) -> None:
        """Begin to collect; mask 0 means all compasses."""
        self.running = True
        self._mask = mask or 0b111
        self._headings.clear()

    def cancel(self) -> None:
        """Stop; the firmware then wants a reboot before it arms, cancelled or not."""
        if self.running:
            self.running = False
            self.reboot_wanted = True

    def observe(self, yaw_rad: float) -> None:
        """Take a reading at a heading."""
        if self.running:
            self._headings.add(math.floor(yaw_rad / _SPACING_RAD))

    def progress(self) -> list[MagCalProgress]:
        """Report the progress of each compass."""
        if not self.running:
            return []
        percent = int(_STEP_ONE_PCT * len(self._headings) / _SAMPLES)
        return [
            MagCalProgress(
                compass_id=i,
                cal_mask=self._mask,
                cal_status=MagCalStatus.RUNNING_STEP_ONE,
                attempt=1,
                completion_pct=percent,
            )
            for i in range(3)
            if self._mask & (1 << i)
        ]
