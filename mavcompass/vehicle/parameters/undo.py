"""Keep on disk what a vehicle held before a write, so that any other tool can put it back too.

Each record is three files of the same name: `.json` with everything, `.param` with the old values in
the form that ground stations load, `.new.param` with the new ones. They are complete and flushed to the disk
before `save` returns, and only their owner can read them. A record knows the vehicle that it belongs to; its
name begins with a number that counts up in its folder, whatever the computer's clock says.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from mavcompass.errors import Refused, UsageError, WriteFailed
from mavcompass.installation.private_files import locked, private_folder, state_directory, write_private
from mavcompass.procedure.dialect import CutShort, ParameterPlan, SaveUndo
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.vehicle.parameters.files import parameter_text

SCHEMA = "mavcompass.undo/1"
DIRECTORY_VARIABLE = "MAVCOMPASS_UNDO_DIR"
_NUMBERED = re.compile(r"(\d{8})-")


@dataclass(frozen=True, slots=True)
class UndoRecord:
    """Hold what a write replaced.

    Attributes:
        made_at: UTC, ISO 8601.
        source: the address of the vehicle as the person gave it.
        before, planned: the values of the parameters that the write was to change.
        parameters: everything that was known of the vehicle's compasses at that time.
        vehicle: whose they are; None in a record of an earlier version, which did not note it.
        for_now: True of values that the run was to put back itself, and so of one that was cut short.
    """

    made_at: str
    autopilot: str
    source: str
    before: Mapping[str, float]
    planned: Mapping[str, float]
    parameters: Mapping[str, float]
    vehicle: Nameplate | None = None
    for_now: bool = False


def undo_directory() -> Path:
    """Return where undo records go: $MAVCOMPASS_UNDO_DIR, or mavcompass/undo in the XDG state folder."""
    if chosen := os.environ.get(DIRECTORY_VARIABLE):
        return Path(chosen)
    return state_directory() / "undo"


def undo_saver(
    source: str,
    directory: Path | None = None,
    utc_now: Callable[[], datetime] = lambda: datetime.now(UTC),
) -> SaveUndo:
    """Build the function that a transaction calls before its first write.

    It raises WriteFailed, nothing being written yet, where the record cannot be put on disk.
    """

    def save(plan: ParameterPlan, parameters: Mapping[str, float], vehicle: Nameplate) -> Path:
        record = UndoRecord(
            utc_now().isoformat(timespec="seconds"),
            vehicle.autopilot,
            source,
            {c.name: c.old for c in plan.changes},
            {c.name: c.new for c in plan.changes},
            dict(parameters),
            vehicle,
            plan.for_now,
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
    """Write the files of a record, flushed to the disk, and return the path of the `.json`.

    Raises OSError, none of them being left, where the disk does not take them all.
    """
    private_folder(folder)
    with locked(folder):
        number = 1 + max(map(_number, folder.glob("*.json")), default=0)
        stamp = re.sub(r"\D", "", record.made_at[:19])
        path = folder / f"{number:08d}-{stamp}-{record.autopilot}.json"
        whose = f"the vehicle at {record.source}"
        if record.vehicle is not None:
            whose += f" ({record.vehicle})"
        comment = (
            f"What {whose} held before mavcompass changed it, {record.made_at}.",
            "Load this file to put it back.",
        )
        document = {
            "schema": SCHEMA,
            "made_at": record.made_at,
            "autopilot": record.autopilot,
            "source": record.source,
            "vehicle": None if record.vehicle is None else record.vehicle.document(),
            "for_now": record.for_now,
            "before": dict(record.before),
            "planned": dict(record.planned),
            "parameters": dict(record.parameters),
        }
        written = (f"What mavcompass wrote to {whose}, {record.made_at}.",)
        try:
            write_private(path.with_suffix(".param"), parameter_text(record.before, "param", comment))
            write_private(written_file(path), parameter_text(record.planned, "param", written))
            write_private(path, json.dumps(document, indent=1) + "\n")
        except OSError:
            remove_record(path)
            raise
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
        vehicle = document.get("vehicle")
        made_at, autopilot, source = (str(document[key]) for key in ("made_at", "autopilot", "source"))
        before, planned, parameters = (
            {str(k): float(v) for k, v in document[key].items()}
            for key in ("before", "planned", "parameters")
        )
        whose = None if vehicle is None else Nameplate.of_document(vehicle)
        for_now = bool(document.get("for_now"))
        return UndoRecord(made_at, autopilot, source, before, planned, parameters, whose, for_now)
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}).", "Check the path.") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(
            f"{path} is not an undo file of mavcompass ({error}).",
            "Give the .json that a write left behind, or a parameter file (.param, .parm, .params).",
        ) from error


def cut_short(directory: Path | None = None) -> CutShort:
    """Build the function that lists what runs which were cut short have left at other values on a vehicle."""

    def left(vehicle: Nameplate) -> list[tuple[Mapping[str, float], Path, Callable[[], None]]]:
        found: list[tuple[Mapping[str, float], Path, Callable[[], None]]] = []
        for path in _newest_first(directory or undo_directory()):
            with suppress(UsageError):  # somebody else's file
                record = load_record(path)
                if record.for_now and record.vehicle is not None and record.vehicle.is_same(vehicle):
                    found.append((record.before, path, partial(remove_record, path)))
        return found

    return left


def _newest_first(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.json"), key=lambda path: (_number(path), path.name), reverse=True)


def newest_record(vehicle: Nameplate | None, folder: Path, known: Collection[str] = ()) -> Path | None:
    """Find the last undo record of a vehicle (None: the last that does not say whose it is), but for `known`.

    Returns None where there is none.
    """
    for path in _newest_first(folder):
        if str(path) in known:
            continue
        try:
            whose = load_record(path).vehicle
        except UsageError:
            continue  # somebody else's file
        if whose is vehicle is None or (whose is not None and vehicle is not None and whose.is_same(vehicle)):
            return path
    return None


def refuse_other_vehicle(path: Path, vehicle: Nameplate) -> None:
    """Raise Refused where a record, or a file that lies beside it, is not of this vehicle.

    A parameter file of anybody else's making says nothing of vehicles, and may be written.
    """
    beside = path.with_name(path.name.split(".")[0] + ".json")
    if not beside.exists():
        return
    try:
        record = load_record(beside)
    except UsageError:
        return
    if record.vehicle is None:
        raise Refused(
            f"{path} does not say which vehicle it is of: an earlier mavcompass made it, {record.made_at}, of"
            f" the vehicle ({record.autopilot}) that was then at {record.source}. This is {vehicle}.",
            "Where that is the same vehicle, add --other-vehicle.",
        )
    if not record.vehicle.is_same(vehicle):
        raise Refused(
            f"{path} is of another vehicle: {record.vehicle}. This is {vehicle}.",
            "Connect that vehicle, choose a file of this one, or write it all the same with --other-vehicle.",
        )


def _number(path: Path) -> int:
    found = _NUMBERED.match(path.name)
    return int(found[1]) if found else 0  # a record of an earlier version, counted by the clock
