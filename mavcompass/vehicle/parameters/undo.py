"""Keep on disk what a vehicle held before a write, so that any other tool can put it back too.

Each record is three files of the same name: `.json` with everything, `.param` with the old values in
the form that ground stations load, `.new.param` with the new ones. They are complete and flushed to the disk
before `save` returns.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from mavcompass.errors import UsageError, WriteFailed
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo
from mavcompass.vehicle.parameters.files import parameter_text

SCHEMA = "mavcompass.undo/1"
DIRECTORY_VARIABLE = "MAVCOMPASS_UNDO_DIR"


@dataclass(frozen=True, slots=True)
class UndoRecord:
    """Hold what a write replaced.

    Attributes:
        made_at: UTC, ISO 8601.
        source: the address of the vehicle as the person gave it.
        before, planned: the values of the parameters that the write was to change.
        parameters: everything that was known of the vehicle's compasses at that time.
    """

    made_at: str
    autopilot: str
    source: str
    before: Mapping[str, float]
    planned: Mapping[str, float]
    parameters: Mapping[str, float]


def undo_directory() -> Path:
    """Return where undo records go: $MAVCOMPASS_UNDO_DIR, or mavcompass/undo in the XDG state folder."""
    if chosen := os.environ.get(DIRECTORY_VARIABLE):
        return Path(chosen)
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "mavcompass" / "undo"


def undo_saver(
    autopilot: str,
    source: str,
    directory: Path | None = None,
    utc_now: Callable[[], datetime] = lambda: datetime.now(UTC),
) -> SaveUndo:
    """Build the function that a transaction calls before its first write.

    It raises WriteFailed, nothing being written yet, where the record cannot be put on disk.
    """

    def save(plan: ParameterPlan, parameters: Mapping[str, float]) -> Path:
        record = UndoRecord(
            utc_now().isoformat(timespec="seconds"),
            autopilot,
            source,
            {c.name: c.old for c in plan.changes},
            {c.name: c.new for c in plan.changes},
            dict(parameters),
        )
        folder = directory or undo_directory()
        try:
            return save_record(record, folder)
        except OSError as error:
            raise WriteFailed(
                f"The undo file could not be written in {folder} ({error.strerror}); nothing was sent to"
                " the vehicle.",
                f"Make room there, or name another folder in {DIRECTORY_VARIABLE}.",
            ) from error

    return save


def save_record(record: UndoRecord, folder: Path) -> Path:
    """Write the files of a record, flushed to the disk, and return the path of the `.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = _free_path(folder, record)
    comment = (
        f"What the vehicle at {record.source} held before mavcompass changed it, {record.made_at}.",
        "Load this file to put it back.",
    )
    _write_through(path.with_suffix(".param"), parameter_text(record.before, "param", comment))
    written = f"What mavcompass wrote to the vehicle at {record.source}, {record.made_at}."
    _write_through(written_file(path), parameter_text(record.planned, "param", (written,)))
    document = {
        "schema": SCHEMA,
        "made_at": record.made_at,
        "autopilot": record.autopilot,
        "source": record.source,
        "before": dict(record.before),
        "planned": dict(record.planned),
        "parameters": dict(record.parameters),
    }
    _write_through(path, json.dumps(document, indent=1) + "\n")
    return path


def written_file(undo_file: Path) -> Path:
    """Return where the new values lie beside an undo file."""
    return undo_file.with_suffix(".new.param")


def remove_record(undo_file: Path) -> None:
    """Delete the files of a record; what the disk does not let go stays."""
    for path in (undo_file, undo_file.with_suffix(".param"), written_file(undo_file)):
        with suppress(OSError):
            path.unlink()


def load_record(path: Path) -> UndoRecord:
    """Read a record; raises UsageError where the file is not one."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"its schema is {document['schema']!r}")
        return UndoRecord(
            str(document["made_at"]),
            str(document["autopilot"]),
            str(document["source"]),
            *(
                {str(k): float(v) for k, v in document[key].items()}
                for key in ("before", "planned", "parameters")
            ),
        )
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}).", "Check the path.") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(
            f"{path} is not an undo file of mavcompass ({error}).",
            "Give the .json that a write left behind, or a parameter file (.param, .parm, .params).",
        ) from error


def newest_record(source: str, folder: Path | None = None) -> Path | None:
    """Find the last undo record of the vehicle at `source`; None where there is none."""
    for path in sorted((folder or undo_directory()).glob("*.json"), reverse=True):
        try:
            if load_record(path).source == source:
                return path
        except UsageError:
            continue  # somebody else's file
    return None


def _free_path(folder: Path, record: UndoRecord) -> Path:
    """Reserve a file name that sorts by time and that no other process takes at the same moment."""
    stamp = re.sub(r"\D", "", record.made_at[:19])
    number = 0
    while True:
        path = folder / f"{stamp}-{number:03d}-{record.autopilot}.json"
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644))
            return path
        except FileExistsError:
            number += 1


def _write_through(path: Path, text: str) -> None:
    """Replace a file at once and see it onto the disk: after a power cut it is whole or absent."""
    half = path.with_name(path.name + ".part")
    with half.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    half.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the file's name, too
    finally:
        os.close(folder)
