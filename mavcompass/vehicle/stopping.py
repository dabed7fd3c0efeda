"""Ctrl-C and SIGTERM as a request to end safely, instead of an exception in the middle of anything."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic
from types import FrameType

# Work that has not taken note of a stop for so long hangs.
_HANGS_S = 2.0
# Who presses Ctrl-C again within this time has pressed it once.
_ONE_PRESS_S = 1.0


@dataclass(slots=True)
class StopRequest:
    """Hold the reason for which somebody wants the work to end; None until then. Any thread may set it.

    Attributes:
        presses: how often a signal asked for it.
        noted_s: when the work last looked at this, on the monotonic clock; it is to do so all the time.
    """

    reason: str | None = None
    presses: int = 0
    noted_s: float = 0.0


@contextmanager
def stop_signals(stop: StopRequest) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into a stop request; a further one interrupts work that hangs.

    Only the main thread can do that; elsewhere nothing is changed and `StopRequest` is the way.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    pressed_s = -_ONE_PRESS_S

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal pressed_s
        now_s = monotonic()
        if now_s - pressed_s > _ONE_PRESS_S:
            stop.presses, pressed_s = stop.presses + 1, now_s
        if stop.reason is None:
            stop.reason = f"Stopped by {'Ctrl-C' if number == signal.SIGINT else 'the system (SIGTERM)'}."
            stop.noted_s = now_s
        elif now_s - stop.noted_s > _HANGS_S:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
