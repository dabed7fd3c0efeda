"""A write that nobody saw the end of: the service was killed between the undo file and the history."""

from __future__ import annotations

import logging
from pathlib import Path

from mavcompass.errors import MavCompassError, UsageError
from mavcompass.service.view import VehicleView
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import History
from mavcompass.vehicle.parameters.transaction import restore_command
from mavcompass.vehicle.parameters.undo import UndoRecord, load_record
from mavcompass.vehicle.parameters.values import same_value

_log = logging.getLogger(__name__)


def note_interrupted_write(history: History, view: VehicleView, undo_folder: Path) -> None:
    """Offer the undo file that the history does not know, where the vehicle holds what it was made for.

    Not simply the newest: the computer's clock may have been set back. `view` knows the parameters in force.
    """
    known = history.undo_files()
    unknown = [path for path in undo_folder.glob("*.json") if str(path) not in known]
    newest = max(unknown, key=lambda path: path.stat().st_mtime_ns, default=None)
    if newest is None:
        return
    try:
        record = load_record(newest)
    except UsageError:
        return  # killed before it was whole, and before anything was written
    if record.autopilot != view.identity.autopilot or not _was_written(record, view):
        return
    command = restore_command(record.source, newest, view.identity.system)
    what = "A write was cut short: the vehicle may hold some new and some old values."
    document = {"error": what, "remedy": f"Undo it, here or with: {command}", "lines": []}
    _log.warning("%s %s", what, document["remedy"])
    try:
        history.add("calibration", utc_now(), view.key, False, what, document, undo_file=str(newest))
    except MavCompassError as error:
        _log.warning("%s", error)


def _was_written(record: UndoRecord, view: VehicleView) -> bool:
    """Tell whether the vehicle holds values that were to be written, and for the rest the old ones."""
    now = view.parameters
    changed = [name for name, old in record.before.items() if name in now and not same_value(now[name], old)]
    return bool(changed) and all(
        name in record.planned and same_value(now[name], record.planned[name]) for name in changed
    )
