"""A helper process for heavy work: it starts with a calibration and ends with it.

Solving needs scipy, reports need templates and diagnoses need minutes. Done here they neither make the
long-running service grow nor hold up its heading. The two speak pickles over a pair of pipes; the child
trusts nobody else.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from mavcompass.errors import MavCompassError

SOLVE_S = 60.0
DIAGNOSE_S = 1800.0


class Worker:
    """Be the service's end: start the child, call it, end it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._closed = False

    def start(self) -> None:
        """Start the child, whose imports then run beside whatever comes first.

        Raises MavCompassError after `close`.
        """
        with self._lock:
            if self._closed:
                raise MavCompassError("The service is stopping.", "Start it again, then try once more.")
            if self._child is None or self._child.poll() is not None:
                self._child = subprocess.Popen(
                    [sys.executable, "-m", "mavcompass.service.worker"],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )

    def call(self, job: str, *arguments: Any, timeout_s: float = SOLVE_S) -> Any:
        """Have a job done and return its result. Raises what the job raises.

        Raises MavCompassError where the child died or took too long.
        """
        self.start()
        child = self._child
        assert child is not None and child.stdin is not None and child.stdout is not None
        # A child that hangs is killed, which ends the read below.
        alarm = threading.Timer(timeout_s, child.kill)
        alarm.start()
        try:
            _write(child.stdin, (job, arguments))
            kind, value = _read(child.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            raise MavCompassError(
                f"The computation of {job!r} ended without a result.",
                "Try again; if it stays, see the service's log.",
            ) from error
        finally:
            alarm.cancel()
        if kind == "error":
            raise value
        return value

    def close(self) -> None:
        """End the child for good."""
        with self._lock:
            self._closed = True
        self.end()

    def end(self) -> None:
        """End the child; the next job starts another."""
        with self._lock:
            child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(OSError):
            if child.stdin is not None:
                child.stdin.close()
        try:
            child.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        if child.stdout is not None:
            child.stdout.close()


def _write(stream: IO[bytes], value: object) -> None:
    data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(len(data).to_bytes(8, "big") + data)
    stream.flush()


def _read(stream: IO[bytes]) -> Any:
    header = stream.read(8)
    if len(header) < 8:
        raise EOFError
    return pickle.loads(stream.read(int.from_bytes(header, "big")))


# --- the child -----------------------------------------------------------------------------------


def solve(
    track: Any, instance: int, windows: list[Any], earth: Any, method: str, max_heading_error_deg: float
) -> Any:
    """Solve one compass; see `vehicle.calibrating.solver`."""
    from mavcompass.vehicle.calibrating import solver

    return solver(method, max_heading_error_deg)(track, instance, windows, earth)


def write_report(report: Any, path: Path) -> None:
    """Write the HTML report of a calibration."""
    from mavcompass.report.calibration import write_report as write

    write(report, path)


def diagnose(recording: Path, report: Path) -> Any:
    """Diagnose the gap of a recording; returns its document, and writes the HTML report."""
    from mavcompass import api
    from mavcompass.service.gap_report import gap_document

    return gap_document(api.diagnose_gap(api.read_track(recording)), report)


JOBS: dict[str, Callable[..., Any]] = {"solve": solve, "write_report": write_report, "diagnose": diagnose}


def main() -> None:
    """Do jobs until the service closes the pipe."""
    jobs, results = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print must not look like a result
    import mavcompass.vehicle.calibrating  # noqa: F401  (all of scipy, before it is needed)

    while True:
        try:
            job, arguments = _read(jobs)
        except EOFError:
            return
        try:
            outcome = ("ok", JOBS[job](*arguments))
        except Exception as error:
            outcome = ("error", error)
        _write(results, outcome)


if __name__ == "__main__":
    main()
