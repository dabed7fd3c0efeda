"""Find the recordings that a person means: files, folders, globs, and the same in object stores.

And tell vehicles apart that share a folder and a system id, as a fleet fresh out of the box does. Marks of a
vehicle: the calibration of its accelerometer, which is its own and hardly ever changes; the offsets of its
compass in force; the device ids of its compasses, which say type and bus: twins share them.
"""

from __future__ import annotations

import glob
import math
import os
import shutil
import tempfile
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from mavcompass.errors import UsageError
from mavcompass.installation.parts import require

SUFFIXES = frozenset({".tlog", ".bin", ".log", ".ulg", ".csv", ".mcap", ".db3"})
_MAGIC = frozenset("*?[")
# What object stores and file systems call the mark that changes with the content.
_CHANGE_MARKS = (
    "ETag",
    "etag",
    "md5Hash",
    "content_md5",
    "LastModified",
    "last_modified",
    "mtime",
    "updated",
)


@dataclass(frozen=True, slots=True)
class Recording:
    """Name one recording.

    Attributes:
        path: absolute path, or URL of an object store.
        size_bytes: None where the store does not tell. stamp: changes when the content does.
        modified_unix_s: when the file was last written; None where unknown.
    """

    path: str
    size_bytes: int | None = None
    stamp: str = ""
    modified_unix_s: float | None = None


def find_recordings(paths: Iterable[str]) -> list[Recording]:
    """Return the recordings behind files, folders, globs and URLs, each once, sorted by path.

    Folders are searched to the bottom for the suffixes of recordings; a file that is named is taken as it
    is. Raises UsageError for a name behind which there is nothing.
    """
    found: dict[str, Recording] = {}
    for path in paths:
        here = _remote(path) if "://" in path else _local(path)
        if not here:
            raise UsageError(
                f"There are no recordings in {path}.",
                f"Give files, or folders and patterns with {', '.join(sorted(SUFFIXES))}.",
            )
        found |= {recording.path: recording for recording in here}
    return [found[path] for path in sorted(found)]


def _is_recording(path: str) -> bool:
    return PurePosixPath(path).suffix.lower() in SUFFIXES


def _local(path: str) -> list[Recording]:
    expanded = os.path.expanduser(path)
    if os.path.isdir(expanded):
        return _in_folder(expanded)
    if os.path.lexists(expanded) or not _MAGIC & set(expanded):
        return [_local_file(expanded)]
    out: list[Recording] = []
    for match in glob.iglob(expanded, recursive=True):
        if os.path.isdir(match):
            # "**" matches the folders as well as what is in them; found twice is taken once.
            out += _in_folder(match)
        elif _is_recording(match):
            out.append(_local_file(match))
    return out


def _in_folder(folder: str) -> list[Recording]:
    return [
        _local_file(os.path.join(where, name))
        for where, _, names in os.walk(folder)
        for name in names
        if _is_recording(name)
    ]


def _local_file(path: str) -> Recording:
    try:
        status = os.stat(path)
    except OSError as error:
        raise UsageError(f"There is no recording {path} ({error.strerror}).", "Check the name.") from error
    stamp = f"{status.st_size}-{status.st_mtime_ns}"
    return Recording(os.path.abspath(path), status.st_size, stamp, status.st_mtime)


def _remote(url: str) -> list[Recording]:
    filesystem, path = _store(url)
    try:
        if _MAGIC & set(path):
            entries = filesystem.glob(path, detail=True)
        elif filesystem.isdir(path):
            entries = filesystem.find(path, detail=True)
        else:
            return [_remote_file(filesystem, path, filesystem.info(path))]
    except Exception as error:  # each store has its own errors
        raise UsageError(
            f"{url} could not be looked at ({type(error).__name__}: {error}).",
            "Check the address, and the credentials that its store expects.",
        ) from error
    return [
        _remote_file(filesystem, name, info)
        for name, info in entries.items()
        if info.get("type") != "directory" and _is_recording(name)
    ]


def _remote_file(filesystem: Any, path: str, info: dict[str, Any]) -> Recording:
    size = info.get("size")
    marks = [str(size), *(str(info[name]) for name in _CHANGE_MARKS if info.get(name) is not None)]
    return Recording(filesystem.unstrip_protocol(path), size, "-".join(marks))


def _store(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path in it."""
    require("An object store")
    import fsspec.core

    try:
        filesystem, path = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise UsageError(
            f"{url} cannot be opened: {error}.",
            "Install what its store needs, e.g. pip install s3fs (s3://).",
        ) from error
    return filesystem, str(path)


@contextmanager
def as_local_file(path: str) -> Iterator[Path]:
    """Give a recording as a file of this machine; what comes from a store is deleted afterwards."""
    if "://" not in path:
        yield Path(path)
        return
    filesystem, inside = _store(path)
    with tempfile.TemporaryDirectory(prefix="mavcompass-") as folder:
        copy = Path(folder) / PurePosixPath(inside).name
        with filesystem.open(inside, "rb") as source, copy.open("wb") as target:
            shutil.copyfileobj(source, target, 1 << 20)
        yield copy


Row = dict[str, Any]
_AXES = ("X", "Y", "Z")
_ACCELEROMETERS = (("INS_ACCOFFS_{}", "INS_ACCSCAL_{}"), ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE"))
_OFFSETS = tuple(f"in_force_offset_{axis.lower()}_mgauss" for axis in _AXES)


def accelerometer_mark(parameters: Mapping[str, float]) -> str | None:
    """Return a short text that is the same for the same accelerometer calibration; None without one."""
    for offset, scale in _ACCELEROMETERS:
        values = [parameters.get(name.format(axis), math.nan) for name in (offset, scale) for axis in _AXES]
        if all(map(math.isfinite, values)) and any(values[:3]):
            return f"{zlib.crc32(repr([round(value, 6) for value in values]).encode()):08x}"
    return None


@dataclass(slots=True)
class _Marks:
    accelerometer: set[str] = field(default_factory=set)
    offsets: set[tuple[int, float, float, float]] = field(default_factory=set)
    device_ids: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Marks:
        own = cls()
        for row in rows:
            offsets = [row.get(name) for name in _OFFSETS]
            if row.get("accelerometer"):
                own.accelerometer.add(row["accelerometer"])
            if None not in offsets and any(offsets):
                own.offsets.add((row["compass"], *(float(value) for value in offsets if value is not None)))
            if row.get("device_ids"):
                own.device_ids.add(row["device_ids"])
        return own

    def may_be(self, other: _Marks) -> bool:
        """Tell whether nothing speaks against one vehicle, or a mark that is its own speaks for it."""
        if self.accelerometer & other.accelerometer or self.offsets & other.offsets:
            return True
        if self.accelerometer and other.accelerometer:
            return False
        return not (self.device_ids and other.device_ids) or bool(self.device_ids & other.device_ids)

    def add(self, other: _Marks) -> None:
        self.accelerometer |= other.accelerometer
        self.offsets |= other.offsets
        self.device_ids |= other.device_ids


def told_apart(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with ", A", ", B", .. after the name that several vehicles share, the earliest first.

    Only names made of folder and system id are in doubt, and only recordings with a result have marks.
    """
    by_name: dict[str, dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row.get("named_by") == "folder":
            by_name[row["vehicle"]][row["recording"]].append(row)
    renamed: dict[str, str] = {}
    for name, recordings in by_name.items():
        groups: list[tuple[_Marks, list[str]]] = []
        for recording, own in sorted(recordings.items(), key=lambda item: (_begun(item[1]), item[0])):
            marks = _Marks.of(own)
            known = next((group for group in groups if group[0].may_be(marks)), None)
            if known is None:
                groups.append((marks, [recording]))
            else:
                known[0].add(marks)
                known[1].append(recording)
        if len(groups) > 1:
            for number, (_, members) in enumerate(groups):
                renamed |= {recording: f"{name}, {_letters(number)}" for recording in members}
    return [row | {"vehicle": renamed.get(row["recording"], row["vehicle"])} for row in rows]


def _begun(rows: Sequence[Row]) -> float:
    known = [row["recorded_unix_s"] for row in rows if row.get("recorded_unix_s") is not None]
    return min(known, default=math.inf)


def _letters(number: int) -> str:
    """Count A, B, .. Z, AA, AB, .."""
    more, last = divmod(number, 26)
    return (_letters(more - 1) if more else "") + chr(ord("A") + last)
