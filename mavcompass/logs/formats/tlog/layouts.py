"""The wire layout of every message of the dialect, as numpy record types."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

UNKNOWN = -1
# Ids above these belong to nobody's dialect; the tables below stay small.
_TABLE_SIZE = 1 << 16


@dataclass(frozen=True, slots=True)
class Layout:
    """Describe one message: its id, its checksum's extra byte and its payload as a record type."""

    name: str
    message_id: int
    crc_extra: int
    record: np.dtype[np.void]


@cache
def layouts() -> dict[int, Layout]:
    """Build the layouts of the dialect's messages by id, version 2 fields (extensions) included."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {
        number: Layout(message.msgname, number, message.crc_extra, _record_type(message))
        for number, message in ardupilotmega.mavlink_map.items()
    }


@cache
def layout(name: str) -> Layout:
    """Find a message by its name; raises KeyError for one that the dialect does not have."""
    for candidate in layouts().values():
        if candidate.name == name:
            return candidate
    raise KeyError(name)


@cache
def crc_extras() -> NDArray[np.int16]:
    """Return the extra bytes by message id, UNKNOWN where the dialect has no such message."""
    table = np.full(_TABLE_SIZE, UNKNOWN, dtype=np.int16)
    for number, message in layouts().items():
        table[number] = message.crc_extra
    return table


def _record_type(message: type) -> np.dtype[np.void]:
    """Turn the struct format '<iih10HB16s' and the names in wire order into a record type."""
    codes = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)  # type: ignore[attr-defined]
    names = message.ordered_fieldnames  # type: ignore[attr-defined]
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for name, (count, code) in zip(names, codes, strict=True):
        if code == "s":
            fields.append((name, f"S{count or 1}"))
        elif count:
            fields.append((name, f"<{code}", (int(count),)))
        else:
            fields.append((name, f"<{code}"))
    return np.dtype(fields)
