"""Read the wanted messages of a telemetry log (.tlog) into columns, told apart by sender.

A record is a time stamp (8 bytes, microseconds of Unix time, most significant first) and one MAVLink
frame, version 1 or 2. Every frame's checksum is checked; signatures cannot be, without the key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.logs.common.chunks import CHUNK_BYTES, Chunk, GrowingArray, read_chunks, windows
from mavcompass.logs.formats.tlog.frames import (
    LONGEST_RECORD,
    PADDING,
    TIMESTAMP_BYTES,
    Frames,
    find_frames,
)
from mavcompass.messages.dialect import Description, Field, describe, message_ids

Sender = tuple[int, int]
ALL_FIELDS: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Hold all messages of one kind from one sender, in the file's order.

    Attributes:
        rows: record array (N,) with the message's field names.
        order: which frame of the file each one was.
        log_time_us: the log's time stamps, microseconds of Unix time by the ground station's clock.
    """

    rows: Any
    order: NDArray[np.uint32]
    log_time_us: NDArray[np.uint64]

    @property
    def log_time_s(self) -> FloatArray:
        """Return the log's time stamps in seconds of Unix time, (N,)."""
        return self.log_time_us.astype(np.float64) * 1.0e-6

    def __len__(self) -> int:
        """Count the messages."""
        return int(self.order.size)

    def select(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Messages:
        """Keep some of them."""
        return Messages(self.rows[which], self.order[which], self.log_time_us[which])


@dataclass(slots=True)
class TlogContents:
    """Hold what was read, and what was not.

    Attributes:
        senders: by (system, component) and message name.
        frames: all good frames of the file; unknown_frames: those of messages outside the dialect.
        skipped_bytes, skipped_stretches: what was neither, and in how many places.
        cut_off: True where the file ends inside a record.
    """

    senders: dict[Sender, dict[str, Messages]] = field(default_factory=dict)
    frames: int = 0
    unknown_frames: int = 0
    skipped_bytes: int = 0
    skipped_stretches: int = 0
    cut_off: bool = False


def read_messages(
    path: Path, wanted: Mapping[str, tuple[str, ...]], chunk_bytes: int = CHUNK_BYTES
) -> TlogContents:
    """Read the `wanted` messages, by name, with the fields named (ALL_FIELDS for all of them).

    `chunk_bytes` of the file are held in memory at a time. Raises KeyError for a name outside the dialect.
    """
    gather = _Gather([(_description(name), fields) for name, fields in wanted.items()])
    contents = TlogContents()
    covered = 0  # all counts of bytes are from the file's start here
    for chunk in read_chunks(path, longest_record=LONGEST_RECORD, padding=PADDING, chunk_bytes=chunk_bytes):
        good, unknown = find_frames(chunk, max(covered - chunk.offset, 0))
        gather.add(chunk, good, contents.frames)
        contents.frames += len(good)
        contents.unknown_frames += len(unknown)
        covered = _count_gaps(contents, chunk, good, unknown, covered)
    rest = path.stat().st_size - covered
    if rest > 0:
        contents.skipped_bytes += rest
        contents.skipped_stretches += 1
        contents.cut_off = rest < LONGEST_RECORD
    contents.senders = gather.senders()
    return contents


def _description(name: str) -> Description:
    found = describe(message_ids()[name])
    assert found is not None
    return found


@cache
def record_type(message: Description) -> np.dtype[np.void]:
    """Return a message's payload as numpy reads it."""
    return np.dtype([(field.name, *_element(field)) for field in message.fields])


def _element(field: Field) -> tuple[str] | tuple[str, tuple[int]]:
    if field.is_text:
        return (f"S{field.count}",)
    return (f"<{field.code}", (field.count,)) if field.count else (f"<{field.code}",)


def _count_gaps(contents: TlogContents, chunk: Chunk, good: Frames, unknown: Frames, covered: int) -> int:
    """Count what lies between the records of this chunk; return where they end in the file."""
    begins = good.start - TIMESTAMP_BYTES
    ends = good.end
    if len(unknown):
        begins = np.sort(np.concatenate([begins, unknown.start - TIMESTAMP_BYTES]))
        ends = np.sort(np.concatenate([ends, unknown.end]))
    if not begins.size:
        return covered
    gaps = np.maximum(begins - np.concatenate([[covered - chunk.offset], ends[:-1]]), 0)
    contents.skipped_bytes += int(gaps.sum())
    contents.skipped_stretches += int(np.count_nonzero(gaps))
    return chunk.offset + int(ends[-1])


class _Gather:
    """Collect the wanted messages chunk by chunk, only the wanted fields of each."""

    def __init__(self, wanted: list[tuple[Description, tuple[str, ...]]]) -> None:
        self._wanted = wanted
        self._growing: dict[tuple[Sender, str], tuple[GrowingArray, GrowingArray, GrowingArray]] = {}

    def add(self, chunk: Chunk, frames: Frames, frames_before: int) -> None:
        for message, names in self._wanted:
            which = np.flatnonzero(frames.message_id == message.id)
            if not which.size:
                continue
            some = frames.select(which)
            found = Messages(
                rows=_payloads(chunk, some, message, names),
                order=(which + frames_before).astype(np.uint32),
                log_time_us=_time_stamps(chunk, some),
            )
            address = some.system.astype(np.int32) << 8 | some.component
            first = int(address[0])
            if bool((address == first).all()):
                self._append(first, message.name, found)
            else:
                for sender in np.unique(address).tolist():
                    self._append(sender, message.name, found.select(address == sender))

    def _append(self, address: int, name: str, found: Messages) -> None:
        key = ((address >> 8, address & 0xFF), name)
        columns = (found.rows, found.order, found.log_time_us)
        if key not in self._growing:
            rows, order, log_time_us = (GrowingArray(column.dtype) for column in columns)
            self._growing[key] = (rows, order, log_time_us)
        for growing, column in zip(self._growing[key], columns, strict=True):
            growing.append(column)

    def senders(self) -> dict[Sender, dict[str, Messages]]:
        out: dict[Sender, dict[str, Messages]] = {}
        for (sender, name), growing in self._growing.items():
            rows, order, log_time_us = (column.finish() for column in growing)
            out.setdefault(sender, {})[name] = Messages(rows.view(np.recarray), order, log_time_us)
        return dict(sorted(out.items()))


def _payloads(chunk: Chunk, frames: Frames, message: Description, names: tuple[str, ...]) -> Any:
    """Decode payloads: zeros that version 2 cut off the end are put back, later extensions are left off."""
    record = record_type(message)
    width = record.itemsize
    raw = windows(chunk.data, frames.payload, width)
    shortest = int(frames.length.min())
    if shortest < width:
        missing = np.arange(shortest, width) >= frames.length[:, np.newaxis]
        raw[:, shortest:][missing] = 0
    rows = raw.view(record)[:, 0]
    if names == ALL_FIELDS:
        return rows
    wanted = np.empty(rows.size, np.dtype([(name, record[name]) for name in names]))
    for name in names:
        wanted[name] = rows[name]
    return wanted


def _time_stamps(chunk: Chunk, frames: Frames) -> NDArray[np.uint64]:
    stamps = windows(chunk.data, frames.start - TIMESTAMP_BYTES, TIMESTAMP_BYTES)
    return stamps.view(">u8")[:, 0].astype(np.uint64)
