"""MAVLink frames from bytes and back, one by one: checksum and sequence number (`mavlink.frame`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from struct import Struct
from typing import Protocol

from mavcompass.messages import Message
from mavcompass.messages.message import (
    CHECKSUM_BYTES,
    FLAGS_AT,
    FRAME_STARTS,
    HEADER_BYTES_1,
    HEADER_BYTES_2,
    LENGTH_AT,
    SIGNATURE_BYTES,
    SIGNED,
    V1,
    V2,
)
from mavcompass.vehicle.wire.codec import encode, wire_format
from mavcompass.vehicle.wire.signing import Signing

_HEADER_1 = Struct("<BBBBBB")
_HEADER_2 = Struct("<BBBBBBBHB")
_CHECKSUM = Struct("<H")
# Ground radios speak of themselves and cannot sign.
_RADIO_STATUS = 109


@dataclass(frozen=True, slots=True)
class Frame:
    """Be one good frame; `raw` is all of its bytes."""

    version: int
    sequence: int
    system: int
    component: int
    message_id: int
    payload: bytes
    raw: bytes


class Counts(Protocol):
    """Be anything that counts what is not handed on, such as `LinkStatistics`."""

    malformed: int
    unknown: int
    signed: int
    refused: int


@cache
def _mcrf4xx() -> Callable[[bytes], int]:
    from fastcrc.crc16 import mcrf4xx

    return mcrf4xx


def checksum(data: bytes, crc_extra: int) -> int:
    """Compute a frame's checksum; `data` is all between the first byte and the checksum."""
    return _mcrf4xx()(data + bytes((crc_extra,)))


@dataclass(slots=True)
class FrameWriter:
    """Make frames for one sender on one connection, counting its sequence."""

    version: int = 2
    signing: Signing | None = None
    _sequence: int = 0

    def write(self, message: Message, system: int, component: int) -> bytes:
        """Return the message as one frame's bytes.

        Raises ValueError for a message whose number is too large for version 1.
        """
        form, payload = encode(message)
        trimmed = payload.rstrip(b"\0") or payload[:1]
        payload = payload[: form.base_length] if self.version == 1 else trimmed
        return self._frame(self.version, payload, system, component, form.id, form.crc_extra)

    def forward(self, frame: Frame) -> bytes:
        """Return another's frame with our sequence number and signature; its version and payload stay.

        Raises ValueError for a message that the dialect does not have.
        """
        form = wire_format(frame.message_id)
        if form is None:
            raise ValueError(f"message {frame.message_id} is not in the dialect")
        sender = (frame.system, frame.component)
        return self._frame(frame.version, frame.payload, *sender, form.id, form.crc_extra)

    def _frame(
        self, version: int, payload: bytes, system: int, component: int, number: int, crc_extra: int
    ) -> bytes:
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFF
        signing = self.signing if version == 2 else None
        if version == 1:
            head = _HEADER_1.pack(V1, len(payload), sequence, system, component, _small(number))
        else:
            flags, low, high = (0 if signing is None else SIGNED), number & 0xFFFF, number >> 16
            head = _HEADER_2.pack(V2, len(payload), flags, 0, sequence, system, component, low, high)
        frame = head + payload
        frame += _CHECKSUM.pack(checksum(frame[1:], crc_extra))
        return frame if signing is None else frame + signing.sign(frame)


def _small(message_id: int) -> int:
    if message_id > 0xFF:
        raise ValueError(f"message {message_id} cannot be sent in MAVLink 1")
    return message_id


@dataclass(slots=True)
class FrameParser:
    """Find frames in a stream of bytes from one connection.

    Whatever is no frame is skipped; `counts.malformed` says how often. A frame of a message that the dialect
    does not have cannot be checked: it is skipped as a whole where the next frame begins right behind it and
    no good one is hidden in it, and counted in `counts.unknown`.
    """

    counts: Counts
    signing: Signing | None = None
    _buffer: bytearray = field(default_factory=bytearray)
    _in_junk: bool = False

    def feed(self, data: bytes) -> list[Frame]:
        """Take in bytes, return the frames that are complete."""
        frames: list[Frame] = []
        buffer = self._buffer
        buffer += data
        at, end = 0, len(buffer)
        while at < end:
            if buffer[at] not in FRAME_STARTS:
                self._count_malformed()
                at = self._next_magic(at)
                continue
            length = frame_length(buffer, at)
            if not length or at + length > end:
                break
            frame = split_frame(bytes(buffer[at : at + length]))
            if wire_format(frame.message_id) is None:
                at = self._skip_unknown(at, length)
            elif self._is_authentic(frame):
                self._in_junk = False
                frames.append(frame)
                at += length
            else:
                self._count_malformed()
                at += 1
        del buffer[:at]
        return frames

    def _next_magic(self, at: int) -> int:
        places = [place for magic in FRAME_STARTS if (place := self._buffer.find(magic, at)) >= 0]
        return min(places, default=len(self._buffer))

    def _count_malformed(self) -> None:
        """Count a stretch of junk once, however many pieces it comes in."""
        if not self._in_junk:
            self._in_junk = True
            self.counts.malformed += 1

    def _skip_unknown(self, at: int, length: int) -> int:
        buffer, end = self._buffer, at + length
        if end < len(buffer) and buffer[end] not in FRAME_STARTS:
            self._count_malformed()
            return at + 1
        inside = self._next_magic(at + 1)
        while inside < end:
            inner = frame_length(buffer, inside)
            if inner and inside + inner <= len(buffer):
                if checksum_is_right(split_frame(bytes(buffer[inside : inside + inner]))):
                    self._count_malformed()
                    return inside
            inside = self._next_magic(inside + 1)
        self.counts.unknown += 1
        return end

    def _is_authentic(self, frame: Frame) -> bool:
        raw = frame.raw
        flags = raw[FLAGS_AT] if frame.version == 2 else 0
        if flags & ~SIGNED or not checksum_is_right(frame):
            return False  # such a flag must be understood and is not
        if self.signing is None:
            self.counts.signed += flags
            return True
        if frame.message_id == _RADIO_STATUS:
            return True
        believed = bool(flags) and self.signing.accepts(raw, frame.system, frame.component)
        self.counts.refused += not believed
        return believed


def checksum_is_right(frame: Frame) -> bool:
    """Check a frame; one of a message that the dialect does not have is never right."""
    form = wire_format(frame.message_id)
    if form is None:
        return False
    signed = frame.version == 2 and frame.raw[FLAGS_AT] & SIGNED
    unsigned = frame.raw[:-SIGNATURE_BYTES] if signed else frame.raw
    return checksum(unsigned[1:-2], form.crc_extra) == int.from_bytes(unsigned[-2:], "little")


def frame_length(buffer: bytearray | bytes, at: int) -> int:
    """Return the length of the frame that begins here; 0 while, or where, that cannot be told."""
    if len(buffer) - at < 3 or buffer[at] not in FRAME_STARTS:
        return 0
    if buffer[at] == V1:
        return buffer[at + LENGTH_AT] + HEADER_BYTES_1 + CHECKSUM_BYTES
    signature = SIGNATURE_BYTES if buffer[at + FLAGS_AT] & SIGNED else 0
    return buffer[at + LENGTH_AT] + HEADER_BYTES_2 + CHECKSUM_BYTES + signature


def split_frame(raw: bytes) -> Frame:
    """Read the header of a whole frame; whether it is a good one `checksum_is_right` tells."""
    header = HEADER_BYTES_1 if raw[0] == V1 else HEADER_BYTES_2
    payload = raw[header : header + raw[LENGTH_AT]]
    if raw[0] == V1:
        _, _, sequence, system, component, number = _HEADER_1.unpack_from(raw)
        return Frame(1, sequence, system, component, number, payload, raw)
    _, _, _, _, sequence, system, component, low, high = _HEADER_2.unpack_from(raw)
    return Frame(2, sequence, system, component, low | high << 16, payload, raw)
