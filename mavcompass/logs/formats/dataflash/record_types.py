"""What a DataFlash log says of itself: the FMT, FMTU, UNIT and MULT records as numpy record types."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from mavcompass.units import MGAUSS_PER_GAUSS, RAD_PER_DEG

HEADER = b"\xa3\x95"
HEADER_BYTES = 3
FMT_TYPE = 0x80
FMT_BYTES = 89

# Format character -> numpy type and the divisor that belongs to the character itself.
_CHARACTERS: dict[str, tuple[str, float]] = {
    "a": ("<i2", 1.0),  # 32 of them
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "g": ("<f2", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "c": ("<i2", 100.0),
    "C": ("<u2", 100.0),
    "e": ("<i4", 100.0),
    "E": ("<u4", 100.0),
    "L": ("<i4", 1.0e7),
    "M": ("u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}
_ARRAY_LENGTH = 32
_SIZES = {c: np.dtype(kind).itemsize for c, (kind, _) in _CHARACTERS.items()} | {"a": 2 * _ARRAY_LENGTH}
TEXT = "nNZ"
_TEXT_FIELDS = {"Name", "Message", "Label", "UnitIds", "MultIds"}
_NAME = re.compile(rb"[A-Za-z0-9_]{1,4}\0*\Z")

# Unit label in the log -> factor to the units used inside.
_INSIDE = {
    "deg": RAD_PER_DEG,
    "degheading": RAD_PER_DEG,
    "deg/s": RAD_PER_DEG,
    "Gauss": MGAUSS_PER_GAUSS,
}


@dataclass(frozen=True, slots=True)
class Field:
    """Describe one field: `divisor` belongs to its character, `factor` turns that into units used inside.

    `factor` is None where the log does not say its unit.
    """

    name: str
    character: str
    divisor: float = 1.0
    factor: float | None = None


@dataclass(frozen=True, slots=True)
class Format:
    """Describe one kind of record: `length` is its bytes with the header."""

    number: int
    name: str
    length: int
    characters: str
    columns: tuple[str, ...]

    @property
    def fields(self) -> dict[str, Field]:
        """Return the fields by name."""
        pairs = zip(self.columns, self.characters, strict=True)
        return {column: Field(column, c, _CHARACTERS[c][1]) for column, c in pairs}

    @property
    def record(self) -> np.dtype[np.void]:
        """Return the bytes after the header as a record type."""
        pairs = zip(self.columns, self.characters, strict=True)
        return np.dtype(
            [
                (column, _CHARACTERS[c][0], (_ARRAY_LENGTH,)) if c == "a" else (column, _CHARACTERS[c][0])
                for column, c in pairs
            ]
        )

    def names(self, wanted: tuple[str, ...]) -> list[str]:
        """Return which of the wanted fields there are, all if none are named.

        A damaged character makes a text of a number: such a field is not the one that was wanted.
        """
        return [
            column
            for column, c in zip(self.columns, self.characters, strict=True)
            if not wanted or (column in wanted and c != "a" and (c in TEXT) == (column in _TEXT_FIELDS))
        ]


def parse_fmt(content: bytes) -> Format | None:
    """Read a FMT record without its header (86 bytes); None where it contradicts itself."""
    number, length = content[0], content[1]
    name, characters, labels = content[2:6], content[6:22], content[22:86]
    if not _NAME.match(name):
        return None
    try:
        text = characters.rstrip(b"\0").decode("ascii")
        columns = labels.rstrip(b"\0").decode("ascii").split(",")
    except UnicodeDecodeError:
        return None
    return make_format(number, length, name.rstrip(b"\0").decode("ascii"), text, columns)


def make_format(number: int, length: int, name: str, characters: str, columns: list[str]) -> Format | None:
    """Build a format; None where characters, column names and length do not go together."""
    names = tuple(stripped for column in columns if (stripped := column.strip()))
    if len(names) != len(characters) or len(set(names)) != len(names):
        return None
    if any(character not in _SIZES for character in characters):
        return None
    if sum(_SIZES[character] for character in characters) + HEADER_BYTES != length:
        return None
    return Format(number, name, length, characters, names)


@dataclass(slots=True)
class Units:
    """Collect UNIT, MULT and FMTU of one log, and say what a field's numbers are in units used inside."""

    labels: dict[str, str] = field(default_factory=dict)
    multipliers: dict[str, float] = field(default_factory=dict)
    of_format: dict[int, tuple[str, str]] = field(default_factory=dict)

    def fields(self, some: Format) -> dict[str, Field]:
        """Return a format's fields with their factors."""
        units, multipliers = self.of_format.get(some.number, ("", ""))
        out: dict[str, Field] = {}
        for index, (name, plain) in enumerate(some.fields.items()):
            label = self.labels.get(units[index]) if index < len(units) else None
            factor = None
            if label:
                factor = _INSIDE.get(label, 1.0)
                if plain.divisor == 1.0 and index < len(multipliers):
                    factor *= self._multiplier(multipliers[index])
            out[name] = Field(name, plain.character, plain.divisor, factor)
        return out

    def _multiplier(self, number: str) -> float:
        # The log keeps them as floats of single precision, and zero for none.
        value = self.multipliers.get(number, 0.0)
        return float(f"{value:.6g}") if value > 0.0 and math.isfinite(value) else 1.0
