"""Child: a process of our own that does one task at a time, and whose death is an answer."""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

from mavcompass.errors import MavCompassError
from mavcompass.fleet.worker import LENGTH

DIED = "WorkerDied"
TIMEOUT = "Timeout"
# A process per core is enough threads; read by the libraries when numpy is first imported.
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class Failure:
    """Say why a task gave no value: `kind` is a word for programs, `text` a sentence for people."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Answer:
    """Hold what a task gave: a value, or the failure."""

    value: Any = None
    failure: Failure | None = None


class Child:
    """Run tasks in a process that finds the same modules as this one.

    Not a `multiprocessing.Process`: those may not be started by the workers of a Dask cluster.
    """

    def __init__(self) -> None:
        """Start the process; it gets no signals of this terminal."""
        search = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mavcompass.fleet.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD, "PYTHONPATH": search},
            start_new_session=True,
        )
        self._ready = False
        self._timeout_s = 0.0
        self._due_s: float | None = None

    @property
    def replies(self) -> IO[bytes]:
        """Return the stream of replies, to wait on."""
        assert self._process.stdout is not None
        return self._process.stdout

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    def give(self, function: Callable[..., Any], arguments: tuple[Any, ...], timeout_s: float) -> None:
        """Give a task; its time begins now."""
        self._timeout_s, self._due_s = timeout_s, time.monotonic() + timeout_s
        task = pickle.dumps((function, arguments))
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its death is told by `receive`
            self._process.stdin.write(LENGTH.pack(len(task)) + task)
            self._process.stdin.flush()

    def left_s(self) -> float:
        """Return the time the task has left."""
        assert self._due_s is not None
        return self._due_s - time.monotonic()

    def receive(self) -> Answer | None:
        """Take what the process says, when `replies` is readable; None for its first word, "ready".

        After an answer of kind DIED the child is of no more use. Raises MavCompassError where the
        process could not even start.
        """
        head = self.replies.read(LENGTH.size)
        content = self.replies.read(LENGTH.unpack(head)[0]) if len(head) == LENGTH.size else b""
        if not content:
            return Answer(failure=self._death())
        kind, said = pickle.loads(content)
        if kind == "ready":
            self._ready = True
            return None
        return Answer(value=said) if kind == "value" else Answer(failure=Failure(*said))

    def give_up(self) -> Answer:
        """Kill the process over its time; the answer says so."""
        self.kill()
        return Answer(failure=Failure(TIMEOUT, f"It took longer than {self._timeout_s:g} s and was stopped."))

    def wait(self) -> Answer:
        """Wait for the task's answer, at most its time."""
        while (left := self.left_s()) > 0.0:
            if select.select([self.replies], [], [], left)[0] and (answer := self.receive()) is not None:
                return answer
        return self.give_up()

    def kill(self) -> None:
        """End the process now."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def _death(self) -> Failure:
        code = self._process.wait()
        self.kill()
        if not self._ready:
            raise MavCompassError(
                f"A worker process ended with code {code} before it could begin.",
                f"Try: {sys.executable} -m mavcompass.fleet.worker </dev/null",
            )
        if code < 0:
            cause = f"signal {-code}, {signal.strsignal(-code) or 'unknown'}"
            cause += "; perhaps out of memory" if -code == signal.SIGKILL else ""
        else:
            cause = f"exit code {code}"
        return Failure(DIED, f"The process that read it died ({cause}).")
