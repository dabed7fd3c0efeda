"""The MAVLink frames of a telemetry log: found many at once in a piece of it, and recorded one by one.

Every byte that could start a frame is a candidate; its checksum decides. So a damaged stretch costs the
frames that it touches and no other, and no search for a new start is needed. Of candidates that overlap
the earlier one wins, as it does for a reader that goes from frame to frame.

The checksums, CRC-16/MCRF4XX, are table look-ups on columns of bytes. A CRC is affine over GF(2): it is the
exclusive-or of one term per byte, which depends on the byte's distance from the end alone, and of a term for
the start value, which depends on the length alone. So bytes of the same distance from the end are handled
together for all frames.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from struct import Struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavcompass.logs.common.chunks import ByteArray, Chunk, IntArray, not_overlapping, windows
from mavcompass.messages import dialect
from mavcompass.messages.message import (
    ADDRESS_AT_1,
    ADDRESS_AT_2,
    CHECKSUM_BYTES,
    FLAGS_AT,
    HEADER_BYTES_1,
    HEADER_BYTES_2,
    ID_AT_1,
    ID_AT_2,
    LENGTH_AT,
    LONGEST_FRAME,
    SIGNATURE_BYTES,
    SIGNED,
    V2,
)

_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, least significant bit first
_START = 0xFFFF
_LONGEST = 280
# From so many frames of one length on, a look-up for each column of bytes is the faster way.
_WORTH_COLUMNS = 400

UInt16Array = NDArray[np.uint16]


@cache
def _byte_terms() -> UInt16Array:
    """Return (distance from the end, byte value) -> its term of the CRC; distance 0 is the last byte."""
    terms = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        terms = (terms >> np.uint16(1)) ^ (terms & np.uint16(1)) * np.uint16(_POLYNOMIAL)
    table = np.empty((_LONGEST, 256), dtype=np.uint16)
    table[0] = terms
    for distance in range(1, _LONGEST):
        before = table[distance - 1]
        table[distance] = terms[before & 0xFF] ^ (before >> 8)
    return table


@cache
def _start_terms() -> UInt16Array:
    """Return length -> what the start value leaves in the CRC after so many bytes."""
    step = _byte_terms()[0]
    out = np.empty(_LONGEST + 1, dtype=np.uint16)
    out[0] = _START
    for length in range(1, _LONGEST + 1):
        before = int(out[length - 1])
        out[length] = int(step[before & 0xFF]) ^ (before >> 8)
    return out


def checksums(
    data: NDArray[np.uint8], ends: IntArray, lengths: IntArray, crc_extras: NDArray[np.uint8]
) -> UInt16Array:
    """Compute the checksums of N frames in `data`.

    `lengths` (N,) are the bytes of each from its length byte to its payload's end, `ends` (N,) the places
    after the payload's end, `crc_extras` (N,) the messages' extra bytes, which follow each payload.
    """
    crc = _start_terms()[lengths + 1]
    crc ^= _byte_terms()[0].take(crc_extras)
    counts = np.bincount(lengths)
    common = counts >= _WORTH_COLUMNS
    for length in np.flatnonzero(common).tolist():
        group = np.flatnonzero(lengths == length)
        crc[group] ^= _by_columns(windows(data, ends[group] - length, length))
    rest = np.flatnonzero(~common[lengths])
    if rest.size:
        crc[rest] ^= _byte_by_byte(data, ends[rest], lengths[rest])
    return crc


def _by_columns(frames: NDArray[np.uint8]) -> UInt16Array:
    """Add up the terms of many frames of one length, (N, length): one look-up for each column."""
    terms = _byte_terms()
    length = frames.shape[1]
    crc = np.zeros(len(frames), dtype=np.uint16)
    for row, column in enumerate(np.ascontiguousarray(frames.T)):
        crc ^= terms[length - row].take(column)
    return crc


def _byte_by_byte(data: NDArray[np.uint8], ends: IntArray, lengths: IntArray) -> UInt16Array:
    """Add up the terms of a few frames of any lengths: one look-up for all of their bytes."""
    total = np.cumsum(lengths)
    distance = np.repeat(total, lengths) - np.arange(int(total[-1]))  # 1 for the last byte of each
    place = np.repeat(ends, lengths) - distance
    terms = _byte_terms().ravel().take(distance * 256 + data[place])
    return np.asarray(np.bitwise_xor.reduceat(terms, total - lengths))


TIMESTAMP_BYTES = 8
LONGEST_RECORD = TIMESTAMP_BYTES + LONGEST_FRAME
PADDING = 512
UNKNOWN = -1
# Their bytes are copied: of noise almost every byte may begin a frame.
_CHECKED_AT_A_TIME = 1 << 15
# Ids above these belong to nobody's dialect; the table stays small.
_TABLE_SIZE = 1 << 16


@dataclass(frozen=True, slots=True)
class Frames:
    """Hold the frames of one chunk as columns, in the file's order; places count from the chunk's start.

    Attributes:
        start, end: the first byte of the frame (after its time stamp), and the one after its last.
        payload, length: where the payload starts and its bytes.
        message_id, system, component: from the header.
    """

    start: IntArray
    end: IntArray
    payload: IntArray
    length: IntArray
    message_id: NDArray[np.int32]
    system: NDArray[np.uint8]
    component: NDArray[np.uint8]

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.start.size)

    def select(self, which: NDArray[np.bool_] | IntArray | slice) -> Frames:
        """Keep some of them."""
        return Frames(*(getattr(self, field.name)[which] for field in fields(self)))


def find_frames(chunk: Chunk, covered: int) -> tuple[Frames, Frames]:
    """Return the good frames that belong to this chunk, and the frames of messages the dialect lacks.

    `covered` is the end of the last frame of the chunk before, counted from this chunk's start: nothing
    starts before it. A frame of an unknown message cannot be checked; it counts as one only where it
    fills the gap between two good frames (or the file's end) exactly.
    """
    candidates = _candidates(chunk, covered)
    known = crc_extras()[np.minimum(candidates.message_id, crc_extras().size - 1)] != UNKNOWN
    checked = candidates.select(known)
    good = np.flatnonzero(_checksum_fits(chunk.data, checked))
    apart = not_overlapping(checked.start[good] - TIMESTAMP_BYTES, checked.end[good])
    frames = checked.select(good[apart])
    return frames, _unknown_between(candidates.select(~known), frames, chunk, covered)


@cache
def crc_extras() -> NDArray[np.int16]:
    """Return the extra bytes by message id, UNKNOWN where the dialect has no such message."""
    table = np.full(_TABLE_SIZE, UNKNOWN, dtype=np.int16)
    for number, extra in dialect.crc_extras().items():
        table[number] = extra
    return table


def _candidates(chunk: Chunk, covered: int) -> Frames:
    data = chunk.data
    first = max(covered, 0) + TIMESTAMP_BYTES
    last = min(chunk.limit + TIMESTAMP_BYTES, chunk.size)
    # 0xFD and 0xFE are the two values that 0xFD can be subtracted from, leaving less than 2.
    start = np.flatnonzero((data[first:last] - np.uint8(V2)) < 2) + first
    version2 = data[start] == V2
    length = data[start + LENGTH_AT].astype(np.intp)
    flags = data[start + FLAGS_AT]
    header = np.where(version2, HEADER_BYTES_2, HEADER_BYTES_1)
    signature = np.where(version2 & (flags == SIGNED), SIGNATURE_BYTES, 0)
    end = start + header + length + CHECKSUM_BYTES + signature
    whole = (end <= chunk.size) & (~version2 | (flags <= SIGNED))
    start, version2, length, header, end = (
        column[whole] for column in (start, version2, length, header, end)
    )
    low = data[start + np.where(version2, ID_AT_2, ID_AT_1)].astype(np.int32)
    high = data[start + ID_AT_2 + 1].astype(np.int32) << 8 | data[start + ID_AT_2 + 2].astype(np.int32) << 16
    address = start + np.where(version2, ADDRESS_AT_2, ADDRESS_AT_1)
    return Frames(
        start=start,
        end=end,
        payload=start + header,
        length=length,
        message_id=np.where(version2, low | high, low),
        system=data[address],
        component=data[address + 1],
    )


def _checksum_fits(data: ByteArray, frames: Frames) -> NDArray[np.bool_]:
    """Tell which frames carry the checksum that their bytes have."""
    fits = np.zeros(len(frames), dtype=bool)
    for first in range(0, len(frames), _CHECKED_AT_A_TIME):
        some = frames.select(slice(first, first + _CHECKED_AT_A_TIME))
        ends = some.payload + some.length
        sent = data[ends].astype(np.uint16) | data[ends + 1].astype(np.uint16) << 8
        extras = crc_extras()[some.message_id].astype(np.uint8)
        fits[first : first + len(some)] = checksums(data, ends, ends - some.start - 1, extras) == sent
    return fits


def _unknown_between(unknown: Frames, good: Frames, chunk: Chunk, covered: int) -> Frames:
    """Keep the unknown frames that follow on a good one (or one another) and are followed by one."""
    begins = unknown.start - TIMESTAMP_BYTES
    opened = _among(good.end, begins) | (begins == covered)
    # What follows a frame at the limit is seen only in the next chunk.
    closed = _among(good.start - TIMESTAMP_BYTES, unknown.end) | (unknown.end >= chunk.limit)
    # Most candidates are chance bytes in payloads: they begin where no other frame ends.
    possible = np.flatnonzero(
        (opened | np.isin(begins, unknown.end)) & (closed | np.isin(unknown.end, begins))
    )
    opens: set[int] = set()
    for index in possible.tolist():
        if opened[index] or int(begins[index]) in opens:
            opened[index] = True
            opens.add(int(unknown.end[index]))
    closes: set[int] = set()
    chained = np.zeros(len(unknown), dtype=bool)
    for index in reversed(possible.tolist()):
        if opened[index] and (closed[index] or int(unknown.end[index]) in closes):
            chained[index] = True
            closes.add(int(begins[index]))
    return unknown.select(chained)


def _among(sorted_places: IntArray, places: IntArray) -> NDArray[np.bool_]:
    """Tell which places are in a sorted list of them."""
    if not sorted_places.size:
        return np.zeros(places.size, dtype=bool)
    index = np.minimum(np.searchsorted(sorted_places, places), sorted_places.size - 1)
    return np.asarray(sorted_places[index] == places)


_TIME_STAMP = Struct(">Q")


class TlogWriter:
    """Write a telemetry log (.tlog): each frame after its time, eight bytes, microseconds of Unix time.

    Use it as a context manager, or call `close`. What was appended is complete on disk after `flush`.
    """

    def __init__(self, path: str | Path) -> None:
        """Create the file; raises OSError where that is not possible."""
        self._file: BinaryIO = Path(path).open("wb")

    def append(self, time_unix_us: int, frame: bytes) -> None:
        """Append one whole MAVLink frame, as it was on the wire."""
        self._file.write(_TIME_STAMP.pack(time_unix_us) + frame)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> TlogWriter:
        """Return the writer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Finish the file."""
        self.close()
