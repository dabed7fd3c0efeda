"""Ctrl-C and SIGTERM as a request to end safely, instead of an exception in the middle of anything."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass(slots=True)
class StopRequest:
    """Hold the reason for which somebody wants the work to end; None until then. Any thread may set it."""

    reason: str | None = None


@contextmanager
def stop_signals(stop: StopRequest) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into a stop request; a second one interrupts at once.

    Only the main thread can do that; elsewhere nothing is changed and `StopRequest` is the way.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.reason is not None:
            raise KeyboardInterrupt
        stop.reason = f"Stopped by {'Ctrl-C' if number == signal.SIGINT else 'the system (SIGTERM)'}."

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
