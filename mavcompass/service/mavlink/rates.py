"""Keep the messages coming that the service needs, whatever reboots or forgets.

Nothing is remembered of what was asked before: what does not come often enough is asked for again. A
reboot, a router that lost us and a lost request all look the same and are cured the same way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.enums import COMPONENT_AUTOPILOT, MavCmd

_JUDGE_EVERY_S = 1.0
_ENOUGH = 0.6  # of the wanted rate: links lose messages, and autopilots round intervals
_PATIENCE_S = (0.3, 1.0, 1.0, 1.0, 3.0, 10.0, 30.0)


@dataclass(slots=True)
class _Wanted:
    rate_hz: float
    heard: int = 0
    asked: int = 0
    next_ask_s: float = -math.inf

    @property
    def asking_hz(self) -> float:
        """Return the rate to ask for: lower after two refusals, as a slow autopilot keeps its old rate."""
        return self.rate_hz / 2.0 ** min(max(self.asked - 1, 0) // 2, 3)


class RateKeeper:
    """Count what comes, ask for what does not."""

    def __init__(self, rates_hz: Mapping[type[mav.Message], float]) -> None:
        self._wanted = {kind: _Wanted(rate) for kind, rate in rates_hz.items()}
        self._judged_s: float | None = None
        self._asked: set[type[mav.Message]] = set()

    def count(self, kind: type[mav.Message]) -> None:
        """Take note of a message heard."""
        wanted = self._wanted.get(kind)
        if wanted is not None:
            wanted.heard += 1

    def vehicle_is_back(self) -> None:
        """Ask for everything at once: it was silent or restarted, and has our wishes no more."""
        self._judged_s = None
        self._wanted = {kind: _Wanted(wanted.rate_hz) for kind, wanted in self._wanted.items()}

    def due(self, now_s: float, system: int) -> list[mav.Message]:
        """Return the requests to send now."""
        if self._judged_s is not None and now_s - self._judged_s < _JUDGE_EVERY_S:
            return []
        span_s = None if self._judged_s is None else now_s - self._judged_s
        self._judged_s = now_s
        requests: list[mav.Message] = []
        for kind, wanted in self._wanted.items():
            enough = span_s is not None and wanted.heard >= math.floor(_ENOUGH * wanted.asking_hz * span_s)
            wanted.heard = 0
            if not enough and now_s >= wanted.next_ask_s:
                patience = _PATIENCE_S[min(wanted.asked, len(_PATIENCE_S) - 1)]
                wanted.asked, wanted.next_ask_s = wanted.asked + 1, now_s + patience
                self._asked.add(kind)
                requests.append(_set_interval(kind, round(1e6 / wanted.asking_hz), system))
        return requests

    def goodbye(self, system: int) -> list[mav.Message]:
        """Return the requests that give the vehicle its own rates back."""
        requests: list[mav.Message] = [_set_interval(kind, 0, system) for kind in self._asked]
        self._asked.clear()
        return requests


def _set_interval(kind: type[mav.Message], interval_us: int, system: int) -> mav.Message:
    return mav.CommandLong(
        system,
        COMPONENT_AUTOPILOT,
        MavCmd.SET_MESSAGE_INTERVAL,
        param1=float(mav.message_id(kind)),
        param2=float(interval_us),
    )
