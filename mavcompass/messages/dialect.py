"""The messages of the dialect: number, name, checksum's extra byte, layout and fields of each.

`messages.txt` holds what pymavlink's ardupilotmega dialect says of them, a line each. Loading that dialect
itself takes half a second and a hundred megabytes, which every command and the service would pay for
layouts alone. `scripts/mavlink_messages.py` writes the file anew; a test holds it against pymavlink.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from struct import Struct, calcsize


@dataclass(frozen=True, slots=True)
class Field:
    """Describe one field.

    Attributes:
        code: of its numbers, as `struct` spells it, "s" for text.
        count: elements of an array, bytes of a text, 0 for a single number.
        is_extension: True for a field of version 2, which version 1 does not know.
    """

    name: str
    code: str
    count: int
    is_extension: bool

    @property
    def is_text(self) -> bool:
        """Tell whether it is one value for `struct`, however many bytes it has."""
        return self.code == "s"


@dataclass(frozen=True, slots=True)
class Description:
    """Describe one message: its number and its checksum's extra byte.

    Attributes:
        declared: its fields as the protocol's definition lists them, those of version 2 (extensions) last.
        fields: the same in the wire's order. payload: that as one struct.
        base_length: bytes without the extensions, which version 1 does not know.
    """

    id: int
    name: str
    crc_extra: int
    declared: tuple[Field, ...]
    fields: tuple[Field, ...]
    payload: Struct
    base_length: int


@cache
def _lines() -> Mapping[int, list[str]]:
    """Return the words of each message's line by its number."""
    table = Path(__file__).with_name("messages.txt").read_text("ascii")
    return {int(words[0]): words for words in map(str.split, table.splitlines())}


@cache
def message_ids() -> Mapping[str, int]:
    """Return the numbers of all messages by their names."""
    return {words[1]: number for number, words in _lines().items()}


@cache
def crc_extras() -> Mapping[int, int]:
    """Return the extra bytes of all messages by their numbers."""
    return {number: int(words[2]) for number, words in _lines().items()}


@cache
def describe(message_id: int) -> Description | None:
    """Describe a message; None for one that the dialect does not have."""
    words = _lines().get(message_id)
    if words is None:
        return None
    _, name, crc_extra, layout, *names = words
    codes = re.findall(r"(\|?)(\d*)([a-zA-Z])", layout)  # such as "BH10H|16s", extensions behind the bar
    declared, extension = [], False
    for field, (bar, count, code) in zip(names, codes, strict=True):
        extension |= bool(bar)
        declared.append(Field(field, code, int(count or code == "s"), extension))
    # On the wire the largest numbers come first, but for extensions (MAVLink, "Field reordering").
    base = sorted((f for f in declared if not f.is_extension), key=lambda f: -calcsize(f"<{f.code}"))
    fields = (*base, *(f for f in declared if f.is_extension))
    whole, short = ("<" + "".join(f"{f.count or ''}{f.code}" for f in some) for some in (fields, base))
    return Description(
        message_id, name, int(crc_extra), tuple(declared), fields, Struct(whole), calcsize(short)
    )
