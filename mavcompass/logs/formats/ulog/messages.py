"""Read the wanted topics of a ULog, PX4's own log, into columns.

A message is its size (two bytes, least significant first), its kind (one) and so many bytes. FORMAT says what
a type's fields are, ADD_LOGGED which type a number stands for, DATA holds one sample of such a number. There
is no checksum: after damage reading goes on at the first message that another one (or the end) follows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct, error
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.logs.common.chunks import CHUNK_BYTES, Chunk, GrowingArray, IntArray, read_chunks, windows
from mavcompass.logs.common.parameter_steps import Seen

MAGIC = b"ULog\x01\x12\x35"
_HEAD_BYTES, _HEADER_BYTES = 16, 3
_LONGEST_MESSAGE = _HEADER_BYTES + 0xFFFF
_KINDS = np.zeros(256, dtype=bool)
_KINDS[list(b"FIMPQADLCSORB")] = True
# PX4's longest has some hundreds of bytes; more beside an unknown kind is no message.
_LONGEST_UNKNOWN = 10_000
# A hundred topics of PX4 have some three thousand fields, three types deep.
_MOST_FIELDS, _DEEPEST = 1 << 15, 8
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "bool": "i1", "char": "i1", "int16_t": "<i2", "uint16_t": "<u2",
    "int32_t": "<i4", "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
}  # fmt: skip
_NUMBER, _STAMP = Struct("<BH"), Struct("<Q")
_VALUES = {"int32_t": Struct("<i"), "float": Struct("<f")}
_MICRO = 1.0e-6
_TEXT_AT = 9  # after severity and time

Fields = list[tuple[str, str]]  # name, numpy type


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """Hold the samples of one topic: `data` by field, (N,) each; `multi_id` counts topics of one name."""

    name: str
    multi_id: int
    data: Mapping[str, NDArray[Any]]

    @property
    def time_s(self) -> FloatArray:
        """Return when the samples were taken, seconds since boot, (N,): of the sample where it is logged."""
        stamp = self.data.get("timestamp_sample")
        if stamp is None or not np.asarray(stamp).any():
            stamp = self.data["timestamp"]
        return np.asarray(stamp, dtype=np.float64) * _MICRO

    def has(self, *names: str) -> bool:
        """Tell whether a topic has all these fields."""
        return all(name in self.data for name in names)

    def vector(self, *names: str) -> FloatArray:
        """Return fields as (N,) or, for several, (N, k)."""
        found = [np.asarray(self.data[name], dtype=np.float64) for name in names]
        return found[0] if len(found) == 1 else np.stack(found).T


def indexed(stem: str, count: int = 3) -> tuple[str, ...]:
    """Spell an array's fields: 'q' is q[0], q[1], ..."""
    return tuple(f"{stem}[{number}]" for number in range(count))


@dataclass(slots=True)
class ULogContents:
    """Hold what was read, and what was not.

    Attributes:
        topics: those wanted that have samples. parameters: as seen, in the file's order.
        texts: the firmware's release, and what the log says in words.
        messages: how many were read. dropouts_ms: what the logger says it lost, each.
        skipped_bytes, skipped_stretches: what was no message, and in how many places.
    """

    topics: list[Topic] = field(default_factory=list)
    parameters: list[Seen] = field(default_factory=list)
    texts: list[bytes] = field(default_factory=list)
    messages: int = 0
    dropouts_ms: list[int] = field(default_factory=list)
    skipped_bytes: int = 0
    skipped_stretches: int = 0


def read_messages(path: Path, wanted: Collection[str], chunk_bytes: int = CHUNK_BYTES) -> ULogContents:
    """Read the `wanted` topics, by name. Raises BadRecording for what is no ULog, or one of a newer kind."""
    reader = _Reader(path, wanted)
    at = _HEAD_BYTES
    chunks = read_chunks(
        path,
        longest_record=_LONGEST_MESSAGE + _HEADER_BYTES,
        padding=_LONGEST_MESSAGE + _HEADER_BYTES,
        chunk_bytes=chunk_bytes,
    )
    for chunk in chunks:
        if not chunk.offset and chunk.data[: len(MAGIC)].tobytes() != MAGIC:
            raise reader.refusal("it does not begin as one")
        at = chunk.offset + reader.read(chunk, at - chunk.offset)
    return reader.finish()


class _Subscription:
    """Gather the samples of one number."""

    def __init__(self, name: str, multi_id: int, fields: Fields) -> None:
        self.name, self.multi_id = name, multi_id
        kinds = [np.dtype(kind) for _, kind in fields]
        self.longest = sum(kind.itemsize for kind in kinds)
        while fields and fields[-1][0].startswith("_padding"):
            fields.pop()
        self.record = np.dtype(fields)  # ValueError for two fields of one name
        self.stamp_at = self.record.fields["timestamp"][1]  # type: ignore[index]  # KeyError for none
        self.rows = GrowingArray(self.record)
        self.starts: list[int] = []


class _Reader:
    def __init__(self, path: Path, wanted: Collection[str]) -> None:
        self._path = path
        self._wanted = wanted
        self._contents = ULogContents()
        self._formats: dict[str, list[tuple[str, int, str]]] = {}
        self._numbers: dict[int, _Subscription | None] = {}
        self._fields_left = _MOST_FIELDS
        self._latest_us = 0

    def refusal(self, why: str) -> BadRecording:
        return BadRecording(
            f"{self._path} is a ULog that cannot be read: {why}.",
            "Copy it from the autopilot's card again, or give another recording.",
        )

    def read(self, chunk: Chunk, at: int) -> int:
        """Read the messages that begin in a chunk, from a place on; return where they end."""
        data = chunk.data.data
        sound: IntArray | None = None
        last = chunk.limit == chunk.size
        while at < chunk.limit:
            size, kind = data[at] | data[at + 1] << 8, data[at + 2]
            end = at + _HEADER_BYTES + size
            if size and end <= chunk.size and (_KINDS[kind] or _is_message(data, size, end)):
                if not self._take(kind, data, at + _HEADER_BYTES, end):
                    self._skip(end - at)
                at = end
                continue
            if sound is None:
                sound = _sound_starts(chunk, last)
            found = int(np.searchsorted(sound, at + 1))
            after = int(sound[found]) if found < sound.size else chunk.limit
            self._skip(after - at)
            at = after
        self._gather(chunk)
        return at

    def _skip(self, count: int) -> None:
        self._contents.skipped_bytes += count
        self._contents.skipped_stretches += 1

    def _take(self, kind: int, data: memoryview, start: int, end: int) -> bool:
        """Take one message; False where it contradicts itself."""
        self._contents.messages += 1
        if kind == _DATA:
            return self._sample(data, start, end)
        take = _TAKERS.get(kind)
        if take is None:
            return True
        try:
            take(self, bytes(data[start:end]))
        except (ValueError, KeyError, IndexError, error):
            return False
        return True

    def _sample(self, data: memoryview, start: int, end: int) -> bool:
        number = data[start] | data[start + 1] << 8 if end - start > 1 else -1
        if number not in self._numbers:
            return False
        one = self._numbers[number]
        if one is None:
            return True
        if not one.record.itemsize <= end - start - 2 <= one.longest:
            return False
        one.starts.append(start + 2)
        self._latest_us = _STAMP.unpack_from(data, start + 2 + one.stamp_at)[0]
        return True

    def _gather(self, chunk: Chunk) -> None:
        """Copy the samples that were found out of the chunk."""
        for one in self._numbers.values():
            if one is not None and one.starts:
                found = windows(chunk.data, np.array(one.starts), one.record.itemsize)
                one.rows.append(found.view(one.record)[:, 0])
                one.starts.clear()

    def _flags(self, body: bytes) -> None:
        if body[8] & ~1 or any(body[9:16]):
            raise self.refusal("it is of a kind that is newer than this program")

    def _format(self, body: bytes) -> None:
        name, _, fields = body.decode("ascii").partition(":")
        found = []
        for text in fields.split(";"):
            if text:
                kind, label = text.split(" ")
                base, bracket, count = kind.partition("[")
                found.append((base, int(count.rstrip("]")) if bracket else 0, label))
        self._formats.setdefault(name, found)  # a log does not contradict itself: the later one is damaged

    def _unfold(self, name: str, prefix: str = "", depth: int = 0) -> Fields:
        """List the fields of a type, those of types within it spelt out."""
        out: Fields = []
        if depth > _DEEPEST:
            raise self.refusal(f"its types are more than {_DEEPEST} deep")
        for base, count, label in self._formats[name]:
            for place in [f"[{n}]" for n in range(count)] if 0 < count <= 0xFFFF else [""]:
                self._fields_left -= 1
                if self._fields_left < 0:
                    raise self.refusal(f"its messages have more than {_MOST_FIELDS} fields")
                if base in _TYPES:
                    out.append((f"{prefix}{label}{place}", _TYPES[base]))
                else:
                    out += self._unfold(base, f"{prefix}{label}{place}.", depth + 1)
        return out

    def _add_logged(self, body: bytes) -> None:
        multi_id, number = _NUMBER.unpack_from(body)
        name = body[_NUMBER.size :].decode("ascii")
        if number not in self._numbers:
            wanted = name in self._wanted
            self._numbers[number] = _Subscription(name, multi_id, self._unfold(name)) if wanted else None

    def _parameter(self, body: bytes) -> None:
        kind, name = body[1 : 1 + body[0]].decode("ascii").split(" ")
        (value,) = _VALUES[kind].unpack(body[1 + body[0] :])
        # What comes before the first topic was read at the start; the rest was set.
        announced = bool(self._numbers)
        time_s = self._latest_us * _MICRO if announced else 0.0
        self._contents.parameters.append(Seen(time_s, name, float(value), announced=announced))

    def _information(self, body: bytes) -> None:
        if body[1 : 1 + body[0]] == b"uint32_t ver_sw_release":
            major, minor, patch = body[:-5:-1][:3]
            self._contents.texts.append(b"PX4 %d.%d.%d" % (major, minor, patch))

    def _text(self, body: bytes) -> None:
        self._contents.texts.append(body[_TEXT_AT:])

    def _dropout(self, body: bytes) -> None:
        self._contents.dropouts_ms.append(int.from_bytes(body[:2], "little"))

    def finish(self) -> ULogContents:
        """Return all that was read."""
        for one in self._numbers.values():
            if one is not None:
                rows = one.rows.finish()
                if rows.size:
                    columns = {name: rows[name] for name in one.record.names or ()}
                    self._contents.topics.append(Topic(one.name, one.multi_id, columns))
        self._contents.topics.sort(key=lambda topic: (topic.name, topic.multi_id))
        return self._contents


_DATA = ord("D")
_TAKERS = {
    ord("B"): _Reader._flags,
    ord("F"): _Reader._format,
    ord("A"): _Reader._add_logged,
    ord("P"): _Reader._parameter,
    ord("O"): _Reader._dropout,
    ord("I"): _Reader._information,
    ord("L"): _Reader._text,
}


def _is_message(data: memoryview, size: int, end: int) -> bool:
    """Tell whether a kind that is not known may be a newer program's: another message follows it."""
    return size <= _LONGEST_UNKNOWN and bool(data[end] | data[end + 1]) and bool(_KINDS[data[end + 2]])


def _sound_starts(chunk: Chunk, last: bool) -> IntArray:
    """Find all places of a chunk where a message may begin that another, or the file's end, follows."""
    data = chunk.data
    first, last_kind = np.flatnonzero(_KINDS)[[0, -1]].astype(np.uint8)
    start = np.flatnonzero(data[2 : chunk.limit + 2] - first <= last_kind - first)  # of holes this is quick
    start = start[_KINDS[data[start + 2]]]
    size = data[start] | data[start + 1].astype(np.intp) << 8
    end = start + _HEADER_BYTES + size
    follows = _KINDS[data[np.minimum(end, chunk.size) + 2]] & (end + _HEADER_BYTES <= chunk.size)
    follows &= (data[np.minimum(end, chunk.size)] | data[np.minimum(end, chunk.size) + 1]) > 0
    if last:
        follows |= end == chunk.size
    return np.asarray(start[(size > 0) & follows])
