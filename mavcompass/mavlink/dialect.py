"""The messages of the dialect, pymavlink's generated description of every message.

This is the only file that knows it; it is loaded with the first message.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from struct import Struct
from typing import Any


@dataclass(frozen=True, slots=True)
class Field:
    """Describe one field on the wire.

    Attributes:
        code: of its numbers, as `struct` spells it, "s" for text.
        count: elements of an array, bytes of a text, 0 for a single number.
    """

    name: str
    code: str
    count: int

    @property
    def is_text(self) -> bool:
        """Tell whether it is one value for `struct`, however many bytes it has."""
        return self.code == "s"


@dataclass(frozen=True, slots=True)
class Description:
    """Describe one message: its number, its checksum's extra byte, its fields in the wire's order.

    The fields of version 2 (extensions) are among them, at the end.
    """

    id: int
    name: str
    crc_extra: int
    payload: Struct
    fields: tuple[Field, ...]


@cache
def _messages() -> Mapping[int, Any]:
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega.mavlink_map


@cache
def message_ids() -> Mapping[str, int]:
    """Return the numbers of all messages by their names."""
    return {message.msgname: number for number, message in _messages().items()}


@cache
def crc_extras() -> Mapping[int, int]:
    """Return the extra bytes of all messages by their numbers."""
    return {number: message.crc_extra for number, message in _messages().items()}


@cache
def describe(message_id: int) -> Description | None:
    """Describe a message; None for one that the dialect does not have."""
    message = _messages().get(message_id)
    if message is None:
        return None
    codes = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)  # such as "<iih10HB16s"
    fields = tuple(
        Field(name, code, int(count or code == "s"))
        for name, (count, code) in zip(message.ordered_fieldnames, codes, strict=True)
    )
    return Description(message_id, message.msgname, message.crc_extra, message.unpacker, fields)
