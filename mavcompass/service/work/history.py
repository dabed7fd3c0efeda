"""What was done to which compass: calibrations, checks, undo files and gap reports, in SQLite.

Entries belong to a vehicle (its autopilot's unique id where it tells one, else its system id) and, where
they are about one compass, to its device id: a swapped compass begins a history of its own.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mavcompass.errors import MavCompassError
from mavcompass.installation.private_files import private_file, private_folder
from mavcompass.vehicle.parameters.undo import remove_record

Kind = Literal["calibration", "check", "undo", "gap"]

# Each step brings a database to the version of its place in the list.
_MIGRATIONS = (
    """
    CREATE TABLE entry (
        id INTEGER PRIMARY KEY,
        made_at TEXT NOT NULL,
        kind TEXT NOT NULL,
        vehicle TEXT NOT NULL,
        ok INTEGER NOT NULL,
        summary TEXT NOT NULL,
        document TEXT NOT NULL,
        report TEXT,
        undo_file TEXT
    );
    CREATE INDEX entry_by_vehicle ON entry (vehicle, kind, id);
    CREATE TABLE entry_compass (
        entry INTEGER NOT NULL REFERENCES entry (id) ON DELETE CASCADE,
        instance INTEGER NOT NULL,
        device INTEGER NOT NULL
    );
    CREATE INDEX entry_compass_by_device ON entry_compass (device, entry);
    """,
    "ALTER TABLE entry ADD COLUMN undone_by INTEGER;",
)


# A year of a calibration an hour. What each compass was last calibrated with is kept for good.
MOST_ENTRIES = 10_000
_FORGET = """
    DELETE FROM entry WHERE id <= :oldest AND id NOT IN (
        SELECT MAX(entry.id) FROM entry JOIN entry_compass ON entry_compass.entry = entry.id
        WHERE kind = 'calibration' AND ok = 1 GROUP BY vehicle, device
    )
"""
_UNDO_FILES = "SELECT undo_file FROM entry WHERE undo_file IS NOT NULL"


@dataclass(frozen=True, slots=True)
class Entry:
    """Hold one line of the history.

    Attributes:
        made_at: UTC, ISO 8601. vehicle: its key. ok: accepted and written, passed, or done.
        compasses: (instance, device id) that it is about. document: the machine-readable result.
        report: path of the HTML report, None where there is none. undo_file: as the write left it.
        undone_by: the undo that has taken it back, None where it stands.
    """

    id: int
    made_at: str
    kind: Kind
    vehicle: str
    ok: bool
    summary: str
    compasses: tuple[tuple[int, int], ...]
    document: Mapping[str, Any]
    report: str | None
    undo_file: str | None
    undone_by: int | None = None

    def head(self) -> dict[str, Any]:
        """Return all but the document, for lists."""
        return {
            "id": self.id,
            "made_at": self.made_at,
            "kind": self.kind,
            "vehicle": self.vehicle,
            "ok": self.ok,
            "summary": self.summary,
            "compasses": [{"instance": i, "device_id": d} for i, d in self.compasses],
            "has_report": self.report is not None,
            "undo_file": self.undo_file,
            "undone_by": self.undone_by,
        }


class History:
    """Keep entries in a file; safe to use from several threads."""

    def __init__(self, path: Path) -> None:
        """Open or make the database. Raises MavCompassError where it cannot be used."""
        self._lock = threading.Lock()
        try:
            private_folder(path.parent)
            private_file(path)  # what SQLite writes beside it takes its rights over
            self._database = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            # After a power cut the file is whole; the last entry may be missing.
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.execute("PRAGMA foreign_keys = ON")
            # Of 2 MB, its default, each calibration would take 17 kB more, and is hardly ever read again.
            self._database.execute("PRAGMA cache_size = -64")
            self._migrate()
        except (OSError, sqlite3.Error) as error:
            raise MavCompassError(
                f"The history {path} cannot be used ({error}).",
                "Make its folder writable, or move the file away to begin a new one.",
            ) from error

    def _migrate(self) -> None:
        version = int(self._database.execute("PRAGMA user_version").fetchone()[0])
        if version > len(_MIGRATIONS):
            raise sqlite3.DatabaseError(f"it was written by a newer mavcompass (version {version})")
        for number, script in enumerate(_MIGRATIONS[version:], version + 1):
            self._database.executescript(f"BEGIN; {script} PRAGMA user_version = {number}; COMMIT;")

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        database = self._database
        with self._lock:
            try:
                database.execute("BEGIN IMMEDIATE")
                yield database
                database.execute("COMMIT")
            except BaseException as error:
                if database.in_transaction:  # a full disk has ended it already
                    database.execute("ROLLBACK")
                if isinstance(error, sqlite3.Error):
                    raise MavCompassError(
                        f"The history could not be written ({error}).", "Make room on the service's disk."
                    ) from error
                raise

    def add(
        self,
        kind: Kind,
        made_at: str,
        vehicle: str,
        ok: bool,
        summary: str,
        document: Mapping[str, Any],
        compasses: Sequence[tuple[int, int]] = (),
        report: str | None = None,
        undo_file: str | None = None,
    ) -> int:
        """Add an entry and return its number; what is forgotten for it takes its undo files along.

        Raises MavCompassError where the disk does not take it.
        """
        forgotten: set[str] = set()
        row = (made_at, kind, vehicle, int(ok), summary, json.dumps(document), report, undo_file)
        with self._transaction() as database:
            cursor = database.execute(
                "INSERT INTO entry (made_at, kind, vehicle, ok, summary, document, report, undo_file)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                row,
            )
            number = int(cursor.lastrowid or 0)
            database.executemany(
                "INSERT INTO entry_compass (entry, instance, device) VALUES (?, ?, ?)",
                [(number, instance, device) for instance, device in compasses],
            )
            if number > MOST_ENTRIES:
                named = _names(database)
                database.execute(_FORGET, {"oldest": number - MOST_ENTRIES})
                forgotten = named - _names(database)
        for name in forgotten:
            remove_record(Path(name))
        return number

    def attach_report(self, number: int, report: str) -> None:
        """Name the HTML report that belongs to an entry."""
        with self._transaction() as database:
            database.execute("UPDATE entry SET report = ? WHERE id = ?", (report, number))

    def undone(self, entry: int, by: int) -> None:
        """Note that an undo has put back what was in force before an entry: it and what was written since are
        undone, and what it had undone itself stands again."""
        with self._transaction() as database:
            database.execute("UPDATE entry SET undone_by = NULL WHERE undone_by = ?", (entry,))
            database.execute(
                "UPDATE entry SET undone_by = :by WHERE id >= :entry AND id < :by AND undone_by IS NULL"
                " AND undo_file IS NOT NULL AND vehicle = (SELECT vehicle FROM entry WHERE id = :by)",
                {"entry": entry, "by": by},
            )

    def undo_files(self) -> set[str]:
        """Return the undo files that entries name."""
        with self._lock:
            return _names(self._database)

    def entry(self, number: int) -> Entry | None:
        """Return one entry, None where there is none of this number."""
        found = self._select("WHERE id = ?", (number,))
        return found[0] if found else None

    def entries(
        self,
        kind: Kind | None = None,
        device: int | None = None,
        before: int | None = None,
        limit: int = 50,
    ) -> list[Entry]:
        """List entries, newest first; `before` an entry's number continues a list."""
        conditions: list[str] = []
        values: list[object] = []
        for column, value in (("kind = ?", kind), ("id < ?", before)):
            if value is not None:
                conditions.append(column)
                values.append(value)
        if device is not None:
            conditions.append("id IN (SELECT entry FROM entry_compass WHERE device = ?)")
            values.append(device)
        where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
        return self._select(f"{where} ORDER BY id DESC LIMIT ?", (*values, limit))

    def latest_calibration(self, vehicle: str, device: int) -> Entry | None:
        """Return the newest calibration of a compass that was accepted and written, and not undone."""
        found = self._select(
            "WHERE kind = 'calibration' AND ok = 1 AND undone_by IS NULL AND vehicle = ?"
            " AND id IN (SELECT entry FROM entry_compass WHERE device = ?) ORDER BY id DESC LIMIT 1",
            (vehicle, device),
        )
        return found[0] if found else None

    def _select(self, rest: str, values: Sequence[object]) -> list[Entry]:
        columns = "id, made_at, kind, vehicle, ok, summary, document, report, undo_file, undone_by"
        with self._lock:
            rows = self._database.execute(f"SELECT {columns} FROM entry {rest}", tuple(values)).fetchall()
            about = {
                row[0]: tuple(
                    self._database.execute(
                        "SELECT instance, device FROM entry_compass WHERE entry = ? ORDER BY instance",
                        (row[0],),
                    ).fetchall()
                )
                for row in rows
            }
        return [
            Entry(i, made_at, kind, vehicle, bool(ok), summary, about[i], json.loads(document), *rest)
            for i, made_at, kind, vehicle, ok, summary, document, *rest in rows
        ]

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._database.close()


def _names(database: sqlite3.Connection) -> set[str]:
    return {str(name) for (name,) in database.execute(_UNDO_FILES)}
