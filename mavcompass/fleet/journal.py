"""Journal: what is done so far, one line per recording, so that a run that was killed goes on."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from mavcompass.errors import UsageError
from mavcompass.fleet.recordings import Recording

SCHEMA = "mavcompass.fleet-journal/1"
Row = dict[str, Any]


class Journal:
    """Keep the rows of finished recordings in a file of JSON lines beside the output.

    The first line says what was asked for. A line that a kill left torn at the end is cut off; a damaged
    one in the middle counts as not done. Use it as a context manager; one process at a time may hold it.
    """

    def __init__(self, path: Path, question: Mapping[str, object], fresh: bool = False) -> None:
        """Open or create the journal for this question (kind of work and its options).

        Raises UsageError where it belongs to another question or process, or cannot be written.
        """
        self.path = path
        self._entries: dict[str, tuple[str, list[Row]]] = {}
        try:
            self._file: IO[bytes] = path.open("ab+")
        except OSError as error:
            raise UsageError(
                f"The journal {path} cannot be written ({error.strerror}).",
                "Give --out a file in a folder that you may write to.",
            ) from error
        try:
            self._lock()
            if fresh:
                self._file.truncate(0)
            self._load(dict(question))
        except BaseException:
            self._file.close()
            raise

    def is_done(self, recording: Recording) -> bool:
        """Tell whether a recording was done with the content it has now."""
        entry = self._entries.get(recording.path)
        return entry is not None and entry[0] == recording.stamp

    def failed(self, recording: Recording) -> bool:
        """Tell whether a recording is done but gave an error."""
        entry = self._entries.get(recording.path)
        return entry is not None and any(row["status"] == "error" for row in entry[1])

    def add(self, recording: Recording, rows: list[Row]) -> None:
        """Keep the rows of a finished recording; a process killed after this has them."""
        self._entries[recording.path] = (recording.stamp, rows)
        self._append({"recording": recording.path, "stamp": recording.stamp, "rows": rows})

    def rows(self) -> list[Row]:
        """Return the latest rows of every recording in the journal, sorted by recording."""
        return [row for path in sorted(self._entries) for row in self._entries[path][1]]

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UsageError(
                f"Another run is writing {self.path}.", "Wait for it, or give another --out."
            ) from error

    def _load(self, question: Row) -> None:
        self._file.seek(0)
        content = self._file.read()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            self._file.truncate(len(whole))
        lines = whole.splitlines()
        if not lines:
            self._append({"schema": SCHEMA, "question": question})
            return
        head = _parsed(lines[0])
        if head is None or head.get("schema") != SCHEMA or head.get("question") != question:
            raise UsageError(
                f"{self.path} belongs to another command or to other options than these.",
                "Give another --out, or --fresh to begin anew.",
            )
        for line in lines[1:]:
            entry = _parsed(line)
            if entry is not None and {"recording", "stamp", "rows"} <= entry.keys():
                self._entries[entry["recording"]] = (entry["stamp"], entry["rows"])

    def _append(self, entry: Row) -> None:
        self._file.write(json.dumps(entry, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Hand everything to the disk and let go."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()

    def __enter__(self) -> Journal:
        """Return the journal itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the file."""
        self.close()


def _parsed(line: bytes) -> Row | None:
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None
