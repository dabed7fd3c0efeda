"""The worker processes of one owner: as many as it has tasks under way, used again, ended together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from mavcompass.errors import MavCompassError
from mavcompass.workers.child import Answer, Child

Task = tuple[Any, ...]


class Children:
    """Do tasks in processes, one in each; any number of threads may ask at the same time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Child] = []
        self._busy: dict[Child, tuple[Task, float]] = {}
        self._ended = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def do(self, function: Callable[..., Any], task: Task, timeout_s: float) -> Answer:
        """Do a task, its arguments, in a process of its own; a process that is lost is replaced.

        Raises MavCompassError where a process could not even begin, or after `end`.
        """
        with self._lock:
            if self._ended:
                raise MavCompassError("The worker processes were ended.")
            child = self._idle.pop() if self._idle else Child()
            self._busy[child] = (task, time.monotonic())
        try:
            return child.do(function, task, timeout_s)
        finally:
            with self._lock:
                del self._busy[child]
                if child.alive and not self._ended:
                    self._idle.append(child)

    def under_way(self) -> list[tuple[Task, float]]:
        """Tell which tasks are being done and for how many seconds, the longest first."""
        now_s = time.monotonic()
        with self._lock:
            busy = [(task, now_s - began_s) for task, began_s in self._busy.values()]
        return sorted(busy, key=lambda item: -item[1])

    def end_idle(self) -> None:
        """End the processes that do nothing; the next task starts another."""
        with self._lock:
            idle, self._idle = self._idle, []
        for child in idle:
            child.end()

    def end(self) -> None:
        """End every process now, and start none again."""
        with self._lock:
            self._ended = True
            everyone = [*self._idle, *self._busy]
        for child in everyone:
            child.end()
