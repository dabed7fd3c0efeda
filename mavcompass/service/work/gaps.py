"""Explain the gap between a calibration's recording and the simulation, beside everything else."""

from __future__ import annotations

import logging
import threading
from typing import Any

from mavcompass.errors import MavCompassError
from mavcompass.procedure.script import Show
from mavcompass.service.config import ServiceConfig
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import Entry, History
from mavcompass.service.work.results import recording_path
from mavcompass.service.work.tasks import Desk, GapRequest, Task
from mavcompass.service.work.worker import DIAGNOSE_S, Worker, diagnose

_log = logging.getLogger(__name__)


class Gaps:
    """Diagnose one recording at a time; the vehicle is not needed for it."""

    def __init__(self, config: ServiceConfig, history: History) -> None:
        self.desk = Desk()
        self._config = config
        self._history = history
        self._worker = Worker()

    def submit(self, entry: Entry) -> Task:
        """Begin with the recording of a calibration. Raises Busy, or MavCompassError without a recording."""
        path = recording_path(self._config.folder, entry.id)
        if not path.is_file():
            raise MavCompassError(
                f"Calibration {entry.id} has no recording any more.",
                "Choose a newer one, or calibrate again.",
            )
        task = self.desk.submit(GapRequest(str(path), entry.id), "http", utc_now())
        self.desk.take()
        threading.Thread(target=self._work, args=(task, entry), name="gap", daemon=True).start()
        return task

    def _work(self, task: Task, entry: Entry) -> None:
        assert isinstance(task.request, GapRequest)
        path = recording_path(self._config.folder, entry.id)
        report = self._config.folder / "reports" / f"gap-{entry.id}.html"
        task.show(Show("diagnose", "Replaying the recording through the simulation.", 0.1))
        try:
            document = self._worker.call(diagnose, path, report, timeout_s=DIAGNOSE_S)
            summary = f"{document.get('verdict', 'unknown')}: {_causes(document) or 'nothing is named'}"
            number = self._history.add(
                "gap",
                utc_now(),
                entry.vehicle,
                True,
                summary,
                document,
                entry.compasses,
                str(report),
            )
            task.finish(True, document, number)
        except Exception as error:
            if not isinstance(error, MavCompassError):
                _log.exception("unexpected error in a diagnosis")
            task.fail(error)
        finally:
            self._worker.end()

    def stop(self) -> None:
        """End a diagnosis that is under way."""
        self.desk.close("The service is stopping.")
        self._worker.close()


def _causes(document: dict[str, Any]) -> str:
    return ", ".join(str(cause.get("effect")) for cause in document.get("causes", ()))
