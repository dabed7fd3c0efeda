"""A write that nobody saw the end of: the service was killed between the undo file and the history."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

from mavcompass.errors import MavCompassError
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.service.work.clock import utc_now
from mavcompass.service.work.history import History
from mavcompass.vehicle.parameters.transaction import restore_command
from mavcompass.vehicle.parameters.undo import UndoRecord, load_record, newest_record
from mavcompass.vehicle.parameters.values import same_value

_log = logging.getLogger(__name__)


def note_interrupted_write(
    history: History, vehicle: Nameplate, parameters: Mapping[str, float], undo_folder: Path
) -> None:
    """Offer the vehicle's last undo file that the history does not know, where it was made for what it holds.

    `parameters` are those in force.
    """
    newest = newest_record(vehicle, undo_folder, history.undo_files())
    if newest is None or not _was_written(record := load_record(newest), parameters):
        return
    command = restore_command(record.source, newest, vehicle.system)
    what = "A write was cut short: the vehicle may hold some new and some old values."
    document = {"error": what, "remedy": f"Undo it, here or with: {command}", "lines": []}
    _log.warning("%s %s", what, document["remedy"])
    try:
        history.add("calibration", utc_now(), vehicle.key, False, what, document, undo_file=str(newest))
    except MavCompassError as error:
        _log.warning("%s", error)


def _was_written(record: UndoRecord, now: Mapping[str, float]) -> bool:
    """Tell whether the vehicle holds values that were to be written, and for the rest the old ones."""
    changed = [name for name, old in record.before.items() if name in now and not same_value(now[name], old)]
    return bool(changed) and all(
        name in record.planned and same_value(now[name], record.planned[name]) for name in changed
    )
