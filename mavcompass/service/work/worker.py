"""A helper process for heavy work: it starts with a calibration and ends with it.

Solving needs numpy, reports need templates and diagnoses need minutes. Done here they neither make the
long-running service grow nor hold up its heading.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mavcompass.errors import MavCompassError, PoorCalibration
from mavcompass.workers import Child

SOLVE_S = 60.0
DIAGNOSE_S = 1800.0


class Worker:
    """Hold the process: start it, have work done in it, end it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: Child | None = None
        self._closed = False

    def start(self) -> Child:
        """Start the process, whose imports then run beside whatever comes first.

        Raises MavCompassError after `close`.
        """
        with self._lock:
            if self._closed:
                raise MavCompassError("The service is stopping.", "Start it again, then try once more.")
            if self._child is None or not self._child.alive:
                self._child = Child("mavcompass.vehicle.calibrating", stderr=None)
            return self._child

    def call(self, function: Callable[..., Any], *arguments: Any, timeout_s: float = SOLVE_S) -> Any:
        """Have a function of a module called there and return its result. Raises what it raises.

        Raises MavCompassError where the process died or took too long.
        """
        answer = self.start().do(function, arguments, timeout_s)
        if answer.failure is None:
            return answer.value
        raise answer.failure.error or MavCompassError(
            f"The computation of {function.__name__!r} ended without a result.",
            "Try again; if it stays, see the service's log.",
        )

    def close(self) -> None:
        """End the process for good."""
        with self._lock:
            self._closed = True
        self.end()

    def end(self) -> None:
        """End the process; the next call starts another."""
        with self._lock:
            child, self._child = self._child, None
        if child is not None:
            child.end()


# --- what is done there; each imports for itself, so that the service does not ----------------------


def learn(pieces: list[Any], instances: tuple[int, ...], earth: Any, limit_deg: float) -> dict[int, Any]:
    """Tell what pieces of a recording show of each compass: a `CalibrationResult`, perhaps refused."""
    from mavcompass.calibration.calibrate import calibrate_compasses, refused
    from mavcompass.calibration.result import Limits
    from mavcompass.track import joined

    track, limits = joined(pieces), Limits(limit_deg, by_motion=True)
    try:
        return calibrate_compasses(track, "running", instances, limits=limits, earth=earth)
    except PoorCalibration as why:
        return {i: refused(track, "running", i, why) for i in instances}


def write_calibration_report(report: Any, path: Path) -> None:
    """Write the HTML report of a calibration."""
    from mavcompass.report.calibration import write_report

    write_report(report, path)


def diagnose(recording: Path, report: Path) -> dict[str, Any]:
    """Diagnose the gap of a recording; return its document, and write the HTML report."""
    from mavcompass import api
    from mavcompass.report.gap import write_gap_report

    diagnosis = api.diagnose_gap(api.read_track(recording))
    report.parent.mkdir(parents=True, exist_ok=True)
    write_gap_report(diagnosis, report)
    return diagnosis.to_json()
