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
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from mavcompass.errors import Refused, UsageError, WriteFailed
from mavcompass.files import read_text
from mavcompass.installation.private_files import locked, private_folder, state_directory, write_private
from mavcompass.procedure.dialect import CutShort, ParameterPlan, SaveUndo
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.vehicle.parameters.files import parameter_text, parse_parameters, read_parameter_text

SCHEMA = "mavcompass.undo/1"
DIRECTORY_VARIABLE = "MAVCOMPASS_UNDO_DIR"
_NUMBERED = re.compile(r"(\d{8})-")
_MARK = re.compile(r"^# vehicle (\{.*)$", re.MULTILINE)


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
        held = f"What {whose} held before mavcompass changed it, {record.made_at}."
        comment = marked(record.vehicle, held, "Load this file to put it back.")
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
        written = marked(record.vehicle, f"What mavcompass wrote to {whose}, {record.made_at}.")
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
        document = json.loads(read_text(path))
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


@dataclass(frozen=True, slots=True)
class KeptValues:
    """Hold the values that a file asks for, and whose they are.

    Attributes:
        vehicle: None where the file does not tell. unmarked: what made it, where it should have told;
            "" for a parameter file of anybody's making, which may be written to any vehicle.
    """

    path: Path
    values: Mapping[str, float]
    vehicle: Nameplate | None = None
    unmarked: str = ""

    def refuse_other(self, vehicle: Nameplate) -> None:
        """Raise Refused where the values are not this vehicle's."""
        if self.unmarked:
            raise Refused(
                f"{self.path} does not say which vehicle it is of: {self.unmarked}. This is {vehicle}.",
                "Where that is the same vehicle, add --other-vehicle.",
            )
        if self.vehicle is not None and not self.vehicle.is_same(vehicle):
            raise Refused(
                f"{self.path} is of another vehicle: {self.vehicle}. This is {vehicle}.",
                "Connect that vehicle, choose a file of this one, or write it all the same with"
                " --other-vehicle.",
            )


def read_kept(path: Path) -> KeptValues:
    """Read an undo file's old values, or a parameter file's. Raises UsageError where it is neither.

    The file is read once: it may be a pipe.
    """
    if path.suffix == ".json":
        return _kept_of(load_record(path), path)
    text = read_parameter_text(path)
    values = parse_parameters(text, str(path))
    if (marked := _MARK.search(text)) is not None:
        try:
            return KeptValues(path, values, Nameplate.of_document(json.loads(marked[1])))
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return KeptValues(path, values, None, "its line of the vehicle is damaged")
    beside = path.with_name(path.name.split(".")[0] + ".json")  # an earlier version's record
    try:
        record = load_record(beside)
    except UsageError:
        return KeptValues(path, values)
    return replace(_kept_of(record, path), values=values)


def _kept_of(record: UndoRecord, path: Path) -> KeptValues:
    old = (
        f"an earlier mavcompass made it, {record.made_at}, of the vehicle ({record.autopilot}) that was then"
        f" at {record.source}"
    )
    return KeptValues(path, record.before, record.vehicle, "" if record.vehicle else old)


def marked(vehicle: Nameplate | None, *comment: str) -> tuple[str, ...]:
    """Return a parameter file's comment with the line that tells whose it is, wherever it is copied."""
    return comment if vehicle is None else (*comment, f"vehicle {json.dumps(vehicle.document())}")


def _number(path: Path) -> int:
    found = _NUMBERED.match(path.name)
    return int(found[1]) if found else 0  # a record of an earlier version, counted by the clock
