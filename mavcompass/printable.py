"""Text as it may stand on a terminal, in a log and in a report, and values as JSON has them."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from enum import Enum
from typing import Any


def printable(text: object) -> str:
    """Spell out (\\x1b, \\n) what would move a terminal's cursor, colour it, or begin another line."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in str(text)
    )


def figure(value: float, form: str) -> str:
    """Spell a number by a %-format; what rounds to nothing has no sign."""
    text = form % value
    return text if float(text) else form % 0.0


def counted(number: int, thing: str) -> str:
    """Spell a number of things: 1 recording, 2 recordings."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def did_you_mean(word: str, known: Collection[str]) -> str:
    """Return a guess at what was meant, with a comma before it, or nothing."""
    close = get_close_matches(word, known, n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def plain(value: Any) -> Any:
    """Return a value as JSON has it; a number that is not finite is None.

    Dataclasses are told by their fields, arrays, tuples and sets as lists, paths as text.
    """
    if hasattr(value, "tolist"):  # an array or a scalar of numpy, which is not imported for this
        value = value.tolist()
    match value:
        case Enum():
            return plain(value.value)
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {plain(key): plain(item) for key, item in value.items()}
        case list() | tuple() | set() | frozenset():
            return [plain(item) for item in value]
        case os.PathLike():
            return os.fspath(value)
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value


def named(names: Sequence[str]) -> str:
    """List sources as people do: "compasses 2 and 3", "compass 1 and gps-yaw"."""
    compasses = [name.removeprefix("compass ") for name in names if name.startswith("compass ")]
    rest = [name for name in names if not name.startswith("compass ")]
    if len(compasses) > 1:
        listed = " and ".join([", ".join(compasses[:-1]), compasses[-1]])
        names = [f"compasses {listed}", *rest]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
