"""Read the wanted records of a binary DataFlash log into columns.

A record is A3 95, its type and its content, whose layout an earlier FMT record gave. There is no
checksum: a record counts where another record's header (or the end of the log) follows at its end. So
after damage reading goes on at the first record that is followed by another one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.credible import open_ended
from mavcompass.frames import FloatArray
from mavcompass.logs.common.chunks import (
    CHUNK_BYTES,
    Chunk,
    GrowingArray,
    not_overlapping,
    read_chunks,
    windows,
)
from mavcompass.logs.formats.dataflash.record_types import (
    FMT_BYTES,
    FMT_TYPE,
    HEADER,
    HEADER_BYTES,
    Field,
    Format,
    Units,
    parse_fmt,
)

_LONGEST_RECORD = 255 + HEADER_BYTES
_PADDING = 512
# The record with which every log begins: FMT describes itself.
_FIRST = HEADER + bytes((FMT_TYPE, FMT_TYPE, FMT_BYTES)) + b"FMT\0"
_FILLING = (0xFF, 0x00)

IntArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """Hold all wanted records of one kind of one log, in the file's order.

    Attributes:
        rows: record array (N,), the wanted fields as stored.
        order: which record of the file each one was.
        fields: what the fields' numbers mean.
        scaled: True where the characters' divisors are in the numbers already (text logs).
    """

    rows: Any
    order: NDArray[np.uint32]
    fields: Mapping[str, Field]
    scaled: bool = False

    def __len__(self) -> int:
        """Count the records."""
        return int(self.order.size)

    def __contains__(self, name: object) -> bool:
        """Tell whether the log has this field (and it was wanted)."""
        return name in self.rows.dtype.names

    def select(self, which: NDArray[np.bool_] | IntArray | slice) -> Records:
        """Keep some of them."""
        return Records(self.rows[which], self.order[which], self.fields, self.scaled)

    def decoded(self, name: str) -> FloatArray:
        """Return a field as the log's own format characters mean it, (N,)."""
        values = np.asarray(self.rows[name], dtype=np.float64)
        divisor = self.fields[name].divisor
        return values if divisor == 1.0 or self.scaled else values / divisor

    def quantity(self, name: str, otherwise: float = 1.0) -> FloatArray:
        """Return a field in the units used inside, (N,); `otherwise`: the factor where the log has none."""
        own = self.fields[name].factor
        factor = otherwise if own is None else own
        values = self.decoded(name)
        if self.fields[name].character == "h":
            values = open_ended(values)
        return values if factor == 1.0 else values * factor


@dataclass(slots=True)
class Log:
    """Hold one log of the file, from one start of logging: its wanted records by name.

    `first_order` is its first record's place among those of the file.
    """

    records: dict[str, Records] = field(default_factory=dict)
    first_order: int = 0


@dataclass(slots=True)
class DataFlashContents:
    """Hold what was read, and what was not.

    Attributes:
        logs: one for each log in the file (more than one where files were put together).
        counts: records of every kind, wanted or not, by name.
        skipped_bytes, skipped_stretches: what was no record, and in how many places.
    """

    logs: list[Log] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    skipped_bytes: int = 0
    skipped_stretches: int = 0


def read_records(
    path: Path, wanted: Mapping[str, tuple[str, ...]], chunk_bytes: int = CHUNK_BYTES
) -> DataFlashContents:
    """Read the `wanted` records by name, of each the named fields that the log has (all, if none named).

    `chunk_bytes` of the file are held in memory at a time.
    """
    contents = DataFlashContents()
    size = path.stat().st_size
    starts = [0, *(start for start in _log_starts(path) if start)]
    records = 0
    for start, end in zip(starts, [*starts[1:], size], strict=True):
        reader = _LogReader(contents, wanted, records)
        reader.read(path, start, end, chunk_bytes)
        records = reader.records
    return contents


def _log_starts(path: Path) -> Iterator[int]:
    for chunk in read_chunks(path, longest_record=len(_FIRST)):
        content = chunk.data[: chunk.size].tobytes()
        at = content.find(_FIRST)
        while 0 <= at < chunk.limit:
            yield chunk.offset + at
            at = content.find(_FIRST, at + 1)


@dataclass(frozen=True, slots=True)
class _Found:
    start: IntArray
    end: IntArray
    kind: NDArray[np.uint8]


class _LogReader:
    """Read one log of a file: learn the formats on the way, gather the wanted records."""

    def __init__(
        self, contents: DataFlashContents, wanted: Mapping[str, tuple[str, ...]], records: int
    ) -> None:
        self.records = self._first_order = records
        self._contents = contents
        self._wanted = {**wanted, "UNIT": (), "MULT": (), "FMTU": ()}
        self._formats: dict[int, Format] = {}
        self._lengths = np.zeros(256, dtype=np.intp)
        self._lengths[FMT_TYPE] = FMT_BYTES
        self._growing: dict[int, tuple[GrowingArray, GrowingArray]] = {}
        self._counts = np.zeros(256, dtype=np.int64)

    def read(self, path: Path, start: int, end: int, chunk_bytes: int) -> None:
        """Read the log between two places of the file and append it to the contents."""
        covered = start
        for chunk in read_chunks(
            path,
            longest_record=_LONGEST_RECORD,
            padding=_PADDING,
            chunk_bytes=chunk_bytes,
            start=start,
            end=end,
        ):
            found = self._find(chunk, covered - chunk.offset)
            self._gather(chunk, found)
            covered = self._count_gaps(chunk, found, covered)
        if covered < end:
            self._skip(end - covered, 1)
        self._finish()

    def _find(self, chunk: Chunk, covered: int) -> _Found:
        data = chunk.data
        first = max(covered, 0)
        start = np.flatnonzero(data[first : chunk.size] == HEADER[0]) + first
        start = start[data[start + 1] == HEADER[1]]
        kind = data[start + 2]
        self._learn(data, start[(kind == FMT_TYPE) & (start + FMT_BYTES <= chunk.size)])
        length = self._lengths[kind]
        end = start + length
        possible = (length > 0) & (end <= chunk.size)
        header_at = np.zeros(chunk.size + _PADDING, dtype=bool)
        header_at[start[length > 0]] = True
        header_at[chunk.size] = chunk.limit == chunk.size
        # A log in flash memory is filled up to the page's end.
        rest_is_filling = _filling_from(data, chunk)
        followed = header_at[np.minimum(end, chunk.size)] | (end >= rest_is_filling)
        good = np.flatnonzero(possible & followed & (start < chunk.limit))
        start, end, kind = start[good], end[good], kind[good]
        keep = not_overlapping(start, end)
        return _Found(start[keep], end[keep], kind[keep])

    def _learn(self, data: NDArray[np.uint8], starts: IntArray) -> None:
        for start in starts.tolist():
            content = data[start + HEADER_BYTES : start + FMT_BYTES].tobytes()
            some = parse_fmt(content)
            if some is not None and (some.number != FMT_TYPE or some.name == "FMT"):
                if some.number in self._formats and some != self._formats[some.number]:
                    continue  # a log does not contradict itself: the later one is damaged
                self._formats[some.number] = some
                self._lengths[some.number] = some.length

    def _gather(self, chunk: Chunk, found: _Found) -> None:
        self._counts += np.bincount(found.kind, minlength=256)
        for number in self._wanted_numbers():
            which = np.flatnonzero(found.kind == number)
            if which.size:
                record, narrow = self._types(number)
                raw = windows(chunk.data, found.start[which] + HEADER_BYTES, record.itemsize).view(record)[
                    :, 0
                ]
                rows = np.empty(which.size, narrow)
                for name in narrow.names or ():
                    rows[name] = raw[name]
                if number not in self._growing:
                    self._growing[number] = (GrowingArray(narrow), GrowingArray(np.dtype(np.uint32)))
                self._growing[number][0].append(rows)
                self._growing[number][1].append((which + self.records).astype(np.uint32))
        self.records += found.start.size

    def _wanted_numbers(self) -> list[int]:
        return [
            number
            for number, some in self._formats.items()
            if some.name in self._wanted and self._formats[number].names(self._wanted[some.name])
        ]

    def _types(self, number: int) -> tuple[np.dtype[np.void], np.dtype[np.void]]:
        """Return a record's type as it stands in the file, and as it is kept: only the wanted fields."""
        some = self._formats[number]
        record = some.record
        return record, np.dtype([(name, record[name]) for name in some.names(self._wanted[some.name])])

    def _count_gaps(self, chunk: Chunk, found: _Found, covered: int) -> int:
        if not found.start.size:
            return covered
        gaps = np.maximum(found.start - np.concatenate([[covered - chunk.offset], found.end[:-1]]), 0)
        self._skip(int(gaps.sum()), int(np.count_nonzero(gaps)))
        return chunk.offset + int(found.end[-1])

    def _skip(self, count: int, stretches: int) -> None:
        self._contents.skipped_bytes += count
        self._contents.skipped_stretches += stretches

    def _finish(self) -> None:
        tables = {
            self._formats[number].name: (self._formats[number], rows.finish(), order.finish())
            for number, (rows, order) in self._growing.items()
        }
        units = _units({name: table[1] for name, table in tables.items() if name in _UNIT_TABLES})
        log = Log(first_order=self._first_order)
        for name, (some, rows, order) in tables.items():
            if name not in _UNIT_TABLES:
                log.records[name] = Records(rows, order, units.fields(some))
        counts = self._contents.counts
        for number, some in self._formats.items():
            if self._counts[number]:
                counts[some.name] = counts.get(some.name, 0) + int(self._counts[number])
        self._contents.logs.append(log)


_UNIT_TABLES = ("UNIT", "MULT", "FMTU")


def _units(tables: Mapping[str, Any]) -> Units:
    units = Units()
    try:
        if "UNIT" in tables:
            for row in tables["UNIT"]:
                units.labels[chr(row["Id"])] = row["Label"].decode("ascii", "replace")
        if "MULT" in tables:
            for row in tables["MULT"]:
                units.multipliers[chr(row["Id"])] = float(row["Mult"])
        if "FMTU" in tables:
            for row in tables["FMTU"]:
                ids = (row["UnitIds"].decode("ascii", "replace"), row["MultIds"].decode("ascii", "replace"))
                units.of_format[int(row["FmtType"])] = ids
    except (ValueError, KeyError):
        return Units()  # not the tables that ArduPilot writes: fall back to the documented units
    return units


def _filling_from(data: NDArray[np.uint8], chunk: Chunk) -> int:
    """Return where the filling at the log's end begins; beyond the chunk where there is none."""
    if chunk.limit != chunk.size or not chunk.size or data[chunk.size - 1] not in _FILLING:
        return chunk.size
    other = np.flatnonzero(data[: chunk.size] != data[chunk.size - 1])
    return int(other[-1]) + 1 if other.size else 0
