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

    `parameters` are those in force of the compasses. What was to be put back at once leaves a file only where
    it was not, and the next calibration puts it back, too.
    """
    newest = newest_record(vehicle, undo_folder, history.undo_files())
    if newest is None:
        return
    record = load_record(newest)
    if record.for_now:
        what = f"A calibration was cut short: {', '.join(record.before)} may not be as before."
    elif _was_written(record, parameters):
        what = "A write was cut short: the vehicle may hold some new and some old values."
    else:
        return
    command = restore_command(record.source, newest, vehicle.system)
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
