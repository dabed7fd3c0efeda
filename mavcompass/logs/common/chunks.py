"""Read a file of any size in overlapping chunks, in bounded memory, and find stretches in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# What is not yet filled is kept in memory as zeros, so a large array grows in smaller steps.
_GROWTH, _LARGE_GROWTH = 1.5, 1.1
_LARGE_ROWS = 1 << 17


class GrowingArray:
    """Collect rows of one type, of which nobody knows beforehand how many will come.

    A large block grows by the system's remapping of its pages; a list of parts would need everything
    twice when it is joined.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._array = np.empty(0, dtype=dtype)
        self._filled = 0

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, (N,)."""
        end = self._filled + rows.size
        if end > self._array.size:
            # Nobody else holds the array before `finish`, so no reference needs to be checked.
            growth = _GROWTH if end < _LARGE_ROWS else _LARGE_GROWTH
            self._array.resize(max(end, int(end * growth) if self._filled else 0), refcheck=False)
        self._array[self._filled : end] = rows
        self._filled = end

    def finish(self) -> NDArray[Any]:
        """Return what was collected; nothing may be appended afterwards."""
        self._array.resize(self._filled, refcheck=False)
        return self._array


ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.intp]

CHUNK_BYTES = 2 << 20
# No line of a recording that is text has so many letters.
MOST_LINE = 1 << 16


@dataclass(frozen=True, slots=True)
class Chunk:
    """Be one piece of a file.

    Attributes:
        data: the bytes, followed by `padding` zeros, so that windows at the end stay inside.
        size: how many of them belong to the file.
        offset: where in the file the first one stands.
        limit: records that start at or after this index are left to the next chunk; `size` in the last.
    """

    data: ByteArray
    size: int
    offset: int
    limit: int


def read_chunks(
    path: Path,
    *,
    longest_record: int,
    padding: int = 0,
    chunk_bytes: int = CHUNK_BYTES,
    start: int = 0,
    end: int | None = None,
) -> Iterator[Chunk]:
    """Cut a file into chunks such that each record of at most `longest_record` bytes lies whole in one.

    A record belongs to the chunk where its start is below `limit`. One buffer is
    reused: a chunk is valid until the next one is asked for. `start` and `end` restrict it to a part of
    the file.
    """
    end = path.stat().st_size if end is None else end
    size = max(min(chunk_bytes, end - start), 4 * longest_record)
    buffer = np.zeros(size + padding, dtype=np.uint8)
    with path.open("rb", buffering=0) as file:
        file.seek(start)
        kept, offset = 0, start
        while True:
            wanted = min(size - kept, end - offset - kept)
            got = _fill(file, buffer[kept : kept + wanted])
            filled = kept + got
            buffer[filled : filled + padding] = 0
            last = got < wanted or offset + filled >= end
            limit = filled if last else filled - longest_record
            yield Chunk(buffer[: filled + padding], filled, offset, limit)
            if last:
                return
            kept = filled - limit
            buffer[:kept] = buffer[limit:filled].copy()
            offset += limit


def _fill(file: FileIO, into: ByteArray) -> int:
    view = into.data
    done = 0
    while done < len(view):
        got = file.readinto(view[done:])
        if not got:
            break
        done += got
    return done


def windows(data: ByteArray, starts: IntArray, width: int) -> ByteArray:
    """Copy `width` bytes from each start: shape (N, width)."""
    return np.lib.stride_tricks.sliding_window_view(data, width)[starts]


def not_overlapping(starts: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Of sorted stretches keep those that do not begin inside an earlier kept one."""
    keep = np.ones(starts.size, dtype=bool)
    # Only those that begin inside any earlier one can be in question.
    for index in (np.flatnonzero(starts[1:] < np.maximum.accumulate(ends)[:-1]) + 1).tolist():
        before = index - 1
        while not keep[before]:
            before -= 1
        keep[index] = starts[index] >= ends[before]
    return keep


def damage(skipped_bytes: int, stretches: int, read: str, at_the_end: bool = False) -> list[str]:
    """Tell of bytes that were left out; `read` says what was read all the same."""
    if not skipped_bytes:
        return []
    places = "1 place" if stretches == 1 else f"{stretches} places"
    where = "its end" if at_the_end and stretches == 1 else places
    return [f"The recording is damaged at {where}: {skipped_bytes} bytes were left out, {read} were read."]
