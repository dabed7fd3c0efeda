"""Two autopilots that speak with one system id: each has a clock of its own, and time goes back and forth.

A clock that runs since boot never falls. Where two are heard in turns it falls again and again, by as much as
one was started before the other. A restart falls once; a damaged time falls by any amount; a burst of late
messages falls less and less.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from mavcompass.frames import FloatArray

# A link may deliver a message late by this much and no more (`logs.common.boot_clock`).
LATEST_S = 1.0
# So many falls by one amount, over so long, are no chance.
_FALLS, _OVER_S = 4, 3.0
# Messages of one kind are as far apart as their rate has it: one that is lost shifts a fall by that.
_SAME_S = 0.5
_KEPT = 32


def shared_id(system: int) -> tuple[str, str]:
    """Say that two autopilots speak with one system id, and what to do."""
    return (
        f"Two autopilots share system id {system}: what one says cannot be told from what the other says.",
        "Give each its own (SYSID_THISMAV or MAV_SYSID, MAV_SYS_ID), or connect and record one at a time.",
    )


class TwoClocks:
    """Notice two clocks in the times since boot of one sender, kind of message by kind."""

    def __init__(self) -> None:
        self.seen = False
        self._last_s: dict[object, float] = {}
        self._falls: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def hear(self, kind: object, boot_s: float, goes_on: bool) -> None:
        """Take the time since boot of a message; those of a kind come in the order in which they were heard.

        One that `goes_on`, by its sequence number, is of the same sender, whatever its clock says.
        """
        last_s = self._last_s.get(kind, boot_s)
        self._last_s[kind] = boot_s
        if boot_s < last_s - LATEST_S and not goes_on:
            self._fell(boot_s, last_s - boot_s)

    def hear_all(self, kind: object, boot_s: FloatArray) -> None:
        """Take the times of all messages of a kind, (N,) in the order in which they were heard."""
        for at in np.flatnonzero(np.diff(boot_s) < -LATEST_S).tolist():
            if self.seen:
                return
            self._fell(float(boot_s[at + 1]), float(boot_s[at] - boot_s[at + 1]))

    def _fell(self, to_s: float, by_s: float) -> None:
        alike = [at_s for at_s, other_s in self._falls if abs(other_s - by_s) <= _SAME_S]
        if any(abs(to_s - at_s) < _OVER_S / _FALLS for at_s in alike):
            return  # fast streams fall so often that what is kept would not reach back far enough
        self._falls.append((to_s, by_s))
        alike.append(to_s)
        self.seen |= len(alike) >= _FALLS and max(alike) - min(alike) >= _OVER_S
