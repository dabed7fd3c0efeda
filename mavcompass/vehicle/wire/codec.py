"""The messages of `mavcompass.messages` as MAVLink payloads, both ways.

Framing (headers, checksums, signatures) is in `framing`.
"""

from __future__ import annotations

from dataclasses import fields
from operator import itemgetter
from struct import Struct
from typing import Any

from mavcompass.messages import Message, kind_named, message_id
from mavcompass.messages.bits import bits_of_single, single_from_bits
from mavcompass.messages.dialect import Description, describe

# The first four bytes of these are a float in name only, see `messages.bits`.
_BITS_FIRST = ("PARAM_VALUE", "PARAM_SET")
_NUMBER_OF_BITS = Struct("<I")


class WireFormat:
    """Read and write one message.

    Attributes:
        id, crc_extra, base_length, full_length: as the dialect says; base without the extension fields.
        kind: the dataclass, None for messages that this program does not use.
    """

    def __init__(self, description: Description) -> None:
        self.id, self.crc_extra = description.id, description.crc_extra
        self.base_length, self.full_length = description.base_length, description.payload.size
        self.kind = kind_named(description.name)
        self._struct = description.payload
        self._defaults = self._struct.unpack(bytes(self.full_length))
        self._places = () if self.kind is None else tuple(_places(description, self.kind))
        numbers_only = not any(count or text for _, _, count, text in self._places)
        at = [at for _, at, _, _ in self._places]
        self._pick = itemgetter(*at) if numbers_only and len(at) > 1 else None
        self._bits_first = description.name in _BITS_FIRST

    def decode(self, payload: bytes) -> Message:
        """Read a payload of any length: what is missing at its end is zero, what is too much is ignored."""
        assert self.kind is not None
        size = self.full_length
        if len(payload) != size:
            payload = payload[:size].ljust(size, b"\0")
        values = self._struct.unpack(payload)
        if self._pick is not None:  # only numbers: the order is all there is to change
            return self.kind(*self._pick(values))
        if self._bits_first:
            values = (single_from_bits(*_NUMBER_OF_BITS.unpack_from(payload)), *values[1:])
        return self.kind(*(_read(values, at, count, text) for _, at, count, text in self._places))

    def encode(self, message: Message) -> bytes:
        """Write a payload of full length; fields that we leave out take the dialect's zero."""
        values = list(self._defaults)
        for name, at, count, text in self._places:
            value = getattr(message, name)
            if text:
                values[at] = value.encode("utf-8", "replace")  # struct cuts it to the field's length
            elif count:
                values[at : at + count] = value
            else:
                values[at] = value
        payload = self._struct.pack(*values)
        if self._bits_first:
            return _NUMBER_OF_BITS.pack(bits_of_single(values[0])) + payload[_NUMBER_OF_BITS.size :]
        return payload


def _read(values: tuple[Any, ...], at: int, count: int, text: bool) -> Any:
    if text:
        return values[at].split(b"\0", 1)[0].decode("utf-8", "replace")
    return values[at : at + count] if count else values[at]


_FORMATS: dict[int, WireFormat] = {}


def wire_format(message_id: int) -> WireFormat | None:
    """Look up a message by its number; None for one that the dialect does not have."""
    form = _FORMATS.get(message_id)
    if form is None and (description := describe(message_id)) is not None:
        form = _FORMATS[message_id] = WireFormat(description)
    return form


def _places(description: Description, kind: type[Message]) -> list[tuple[str, int, int, bool]]:
    """Say where each field of the dataclass stands among the struct's values: name, at, count, text.

    Text is one value of the struct, an array as many as it has elements.
    """
    starts: dict[str, tuple[int, int, bool]] = {}
    at = 0
    for field in description.fields:
        starts[field.name] = (at, 0 if field.is_text else field.count, field.is_text)
        at += 1 if field.is_text else max(field.count, 1)
    return [(field.name, *starts[field.name]) for field in fields(kind)]


def decode(message_id: int, payload: bytes) -> Message | None:
    """Read a message; None for one that this program does not use."""
    form = wire_format(message_id)
    return None if form is None or form.kind is None else form.decode(payload)


def encode(message: Message) -> tuple[WireFormat, bytes]:
    """Write a message: its format and its payload at full length.

    Raises struct.error where a number does not fit its field: that is a mistake in this program.
    """
    form = wire_format(message_id(type(message)))
    assert form is not None
    return form, form.encode(message)
