"""Turn what procedures found into documents, history, reports and recordings."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.errors import MavCompassError, UsageError
from mavcompass.heading.deviation import seen_by_old
from mavcompass.installation.private_files import private_folder, write_private
from mavcompass.messages import Incoming
from mavcompass.printable import counted, plain
from mavcompass.procedure.check import CheckReport
from mavcompass.procedure.dialect import WriteOutcome
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Show
from mavcompass.report.document import live_document
from mavcompass.service.config import ServiceConfig
from mavcompass.service.view import VehicleView
from mavcompass.service.work import clock
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.tasks import CalibrationRequest, Task, UndoRequest
from mavcompass.service.work.worker import Worker, write_calibration_report
from mavcompass.vehicle.session import WriteReport
from mavcompass.vehicle.wire import FrameWriter

_log = logging.getLogger(__name__)

_KEPT_RECORDINGS, _KEPT_REPORTS = 50, 200
# Ten minutes of a fast link; what comes after is not needed to explain a calibration.
_MOST_BYTES = 64_000_000
_CARD_STEP = 3  # of the 72 headings: every 15 degrees


class Recorder:
    """Record a calibration as a .tlog, which every tool of the field reads: what the vehicle says, frames
    with their time of arrival, microseconds since 1970, big-endian."""

    def __init__(self) -> None:
        self._writers: dict[tuple[int, int], FrameWriter] = {}
        self._data = bytearray()
        self._offset_s: float | None = None

    def add(self, heard: Incoming) -> None:
        """Append one message."""
        if len(self._data) > _MOST_BYTES:
            return
        if self._offset_s is None:
            self._offset_s = clock.now().timestamp() - heard.time_s
        sender = (heard.system, heard.component)
        if sender not in self._writers:
            self._writers[sender] = FrameWriter(2, None)
        stamp_us = round((heard.time_s + self._offset_s) * 1e6)
        self._data += stamp_us.to_bytes(8, "big")
        self._data += self._writers[sender].write(heard.message, heard.system, heard.component)

    def save(self, path: Path) -> None:
        """Write the file. Raises OSError."""
        private_folder(path.parent)
        write_private(path, self._data, flushed=False)


class Results:
    """Record how requests ended."""

    def __init__(self, config: ServiceConfig, history: History, worker: Worker) -> None:
        self._config = config
        self._history = history
        self._worker = worker

    def calibrated(
        self, task: Task, view: VehicleView, report: CalibrationReport, recorder: Recorder
    ) -> None:
        """Record a calibration, accepted or not."""
        assert isinstance(task.request, CalibrationRequest)
        task.results = report.results  # the proof solves anew, but what counts is what was written
        document = live_document(self._config.vehicle.source, report, task.request.method)
        document["old_and_new"] = [old_and_new(result) for result in report.results]
        document["in_force"] = _left_in_force(report)
        ok = report.accepted and not report.undone
        undo_file = document["undo_file"]
        number = self._record(
            task,
            view,
            report.written,
            _summary(report),
            document,
            [(result.instance, view.device_id(result.instance)) for result in report.results],
            None if undo_file is None else str(undo_file),
        )
        if number is not None:
            self._save_recording(recorder, number)
            self._save_report(report, number)
        task.finish(ok, document, number)

    def _record(
        self,
        task: Task,
        view: VehicleView | None,
        ok: bool,
        summary: str,
        document: Mapping[str, Any],
        compasses: Sequence[tuple[int, int]] = (),
        undo_file: str | None = None,
    ) -> int | None:
        """Add an entry; where the disk does not take it, that is told, and what was done stays done."""
        key = "unknown" if view is None else view.key
        try:
            return self._history.add(
                task.request.kind, utc_now(), key, ok, summary, document, compasses, undo_file=undo_file
            )
        except MavCompassError as error:
            _log.warning("%s", error)
            task.show(Show("end", str(error)))
            return None

    def _save_recording(self, recorder: Recorder, number: int) -> None:
        folder = self._config.folder / "recordings"
        try:
            recorder.save(recording_path(self._config.folder, number))
            _keep_latest(folder, _KEPT_RECORDINGS)
        except OSError as error:
            _log.warning("the recording of calibration %d could not be kept: %s", number, error)

    def _save_report(self, report: CalibrationReport, number: int) -> None:
        path = self._config.folder / "reports" / f"calibration-{number}.html"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._worker.call(write_calibration_report, report, path)
            _keep_latest(path.parent, _KEPT_REPORTS)
            self._history.attach_report(number, str(path))
        except (OSError, MavCompassError, ImportError) as error:
            _log.warning("the report of calibration %d could not be written: %s", number, error)

    def checked(self, task: Task, view: VehicleView, report: CheckReport) -> None:
        """Record a pre-flight check."""
        document = report.to_json()
        compasses = [(instance, view.device_id(instance)) for instance in view.instances()]
        ok = report.verdict != "fail"
        task.finish(ok, document, self._record(task, view, ok, report.summary(), document, compasses))

    def undone(self, task: Task, view: VehicleView, report: WriteReport) -> None:
        """Record that an undo file was put back; a vehicle that held its values already was sent nothing."""
        assert isinstance(task.request, UndoRequest)
        outcome = report.outcome or WriteOutcome(verified=True, undo_file=None, values={})
        undo_file = None if outcome.undo_file is None else str(outcome.undo_file)
        document: dict[str, Any] = {
            "schema": "mavcompass.undone/1",
            "verified": outcome.verified,
            "put_back": task.request.undo_file,
            "undo_file": undo_file,
            "values": dict(outcome.values),
        }
        summary = f"{counted(len(outcome.values), 'parameter')} put back."
        number = self._record(task, view, outcome.verified, summary, document, undo_file=undo_file)
        if number is not None:
            self._history.undone(task.request.entry, number)
        task.finish(outcome.verified, document, number)

    def failed(self, task: Task, view: VehicleView | None, error: Exception) -> None:
        """Record that a request came to nothing."""
        task.fail(error)
        document = {"error": task.error, "remedy": task.remedy, "lines": task.lines[-20:]}
        left = getattr(error, "undo_file", None)
        undo_file = None if left is None else str(left)
        task.entry = self._record(task, view, False, task.error, document, undo_file=undo_file)

    def undo_path(self, request: UndoRequest) -> Path:
        """Find the undo file that a request names. Raises UsageError for any other file."""
        folder = (self._config.folder / "undo").resolve()
        path = (folder / Path(request.undo_file).name).resolve()
        if path.parent != folder or not path.is_file():
            raise UsageError(
                f"There is no undo file {Path(request.undo_file).name}.", "Choose one from the history."
            )
        return path


def _keep_latest(folder: Path, most: int) -> None:
    """Delete files named by their entry but the last ones; the computer's clock may have been set back."""
    numbered = {path.stem.rpartition("-")[2]: path for path in folder.glob("calibration-*")}
    for number in sorted((int(number) for number in numbered if number.isdecimal()), reverse=True)[most:]:
        numbered[str(number)].unlink()


def recording_path(folder: Path, entry: int) -> Path:
    """Return where the recording of a calibration lies."""
    return folder / "recordings" / f"calibration-{entry}.tlog"


def sigma_deg(entry: Entry, instance: int) -> float | None:
    """Return the heading sigma that a calibration in the history claims for a compass."""
    for compass in entry.document.get("compasses", ()):
        if compass.get("instance") == instance:
            sigma = compass.get("heading_sigma_deg")
            return float(sigma) if sigma is not None else None
    return None


def _summary(report: CalibrationReport) -> str:
    parts = []
    for result in report.results:
        if not result.accepted:
            parts.append(f"compass {result.instance} not accepted")
        elif math.isfinite(result.heading_sigma_deg):
            parts.append(f"compass {result.instance} within {result.heading_sigma_deg:.1f} deg")
        else:
            parts.append(f"compass {result.instance} accepted")
    end = "written" if report.written else "put back" if report.undone else "not written"
    steers = ""
    if report.heading is not None and report.steers_off:
        steers = f". {report.heading.summary().rstrip('.')}"
    return f"{', '.join(parts)}; {end}{steers}"


def _left_in_force(report: CalibrationReport) -> dict[str, Mapping[str, float]]:
    """Return by compass what a written calibration left: of one that was right already, what there was."""
    were = report.track.parameters
    return {
        str(result.instance): {name: were[name] for name in result.parameters if name in were}
        if result.already_right
        else result.parameters
        for result in report.results
    }


def old_and_new(result: CalibrationResult) -> dict[str, Any]:
    """Set the correction that was in force beside the new one: how far off each is, the old one's deviation
    card, and what it makes, forward and right, of the circle that the new one shows."""
    document: dict[str, Any] = {
        "instance": result.instance,
        "accepted": result.accepted,
        "already_right": result.already_right,
        "before_deg": plain(round(result.heading_change_deg, 3)),
        "after_deg": plain(round(result.heading_sigma_deg, 3)),
        "horizontal_mgauss": plain(round(result.horizontal_mgauss, 3)),
        "old_circle": [],
        "old": _correction(result.in_force),
        "new": _correction(result.correction),
        "deviation": [],
    }
    if (change_deg := result.in_force_error_deg()) is not None:
        field = (result.in_force, result.correction, result.horizontal_mgauss, result.vertical_mgauss)
        document["old_circle"] = np.round(seen_by_old(*field)[0][::2, :2], 1).tolist()
        document["deviation"] = [
            {"heading_deg": 5.0 * k, "old_error_deg": round(float(change_deg[k]), 2)}
            for k in range(0, 72, _CARD_STEP)
        ]
    return document


def _correction(correction: FieldCorrection) -> dict[str, Any]:
    return {
        "offsets_mgauss": list(correction.offsets_mgauss),
        "diagonals": list(correction.diagonals),
        "off_diagonals": list(correction.off_diagonals),
        "scale": correction.scale,
    }
