"""A process of our own that does one task at a time, and whose death is an answer; those of one owner.

An owner has as many as it has tasks under way; they are used again and ended together.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from mavcompass.errors import MavCompassError

DIED = "WorkerDied"
TIMEOUT = "Timeout"
# A process per core is enough threads; read by the libraries when numpy is first imported.
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class Failure:
    """Say why a task gave no value: `kind` is a word for programs, `text` a sentence for people.

    `error` is what the task raised, None where it raised nothing or that cannot travel.
    """

    kind: str
    text: str
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """Hold what a task gave: a value, or the failure."""

    value: Any = None
    failure: Failure | None = None


class Child:
    """Run tasks in a process that finds the same modules as this one, and ends with this object.

    Not a `multiprocessing.Process`: those may not be started by the workers of a Dask cluster.
    """

    def __init__(self, module: str | None = None, stderr: int | None = subprocess.DEVNULL) -> None:
        """Start the process, which imports `module`; it gets no signals of this terminal.

        What it prints is dropped, and what it complains of goes to `stderr`, as `subprocess` has it.
        """
        search = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self._line, theirs = multiprocessing.Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mavcompass.workers", str(theirs.fileno())]
                + ([module] if module else []),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env={**os.environ, **_ONE_THREAD, "PYTHONPATH": search},
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        self._ready = False
        self._end = weakref.finalize(self, _end, self._process)

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Tell whether it can take a task."""
        return self._process.poll() is None

    def do(self, function: Callable[..., Any], arguments: tuple[Any, ...], timeout_s: float) -> Answer:
        """Do a task in the process; one that takes longer than its time is ended with the process.

        Raises MavCompassError where the process could not even begin.
        """
        due_s = time.monotonic() + timeout_s
        try:
            self._line.send((function, arguments))
            while self._line.poll(max(due_s - time.monotonic(), 0.0)):
                said = self._line.recv()
                if said != "ready":
                    return Answer(said[1]) if said[0] == "value" else Answer(failure=Failure(*said[1:]))
                self._ready = True
        except (EOFError, OSError):
            return Answer(failure=self._death())
        self.end()
        return Answer(failure=Failure(TIMEOUT, f"It took longer than {timeout_s:g} s and was stopped."))

    def end(self) -> None:
        """End the process now; any thread may, and one that waits for an answer is told of the death."""
        self._end()

    def _death(self) -> Failure:
        code = self._process.wait()
        self.end()
        if not self._ready:
            raise MavCompassError(
                f"A worker process ended with code {code} before it could begin.",
                f"Try: {sys.executable} -m mavcompass.workers 0 </dev/null",
            )
        if code < 0:
            cause = f"signal {-code}, {signal.strsignal(-code) or 'unknown'}"
            cause += "; perhaps out of memory" if -code == signal.SIGKILL else ""
        else:
            cause = f"exit code {code}"
        return Failure(DIED, f"The process that read it died ({cause}).")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


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
