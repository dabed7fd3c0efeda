"""Numbers that were found once and are to be found again: made plain, compared, told where they differ."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

# Solvers and libraries differ in the last digits; a constant that is changed does in the first ones.
RELATIVE, ABSOLUTE = 1e-4, 1e-6


def plain(value: Any) -> Any:
    """Turn what was found into what JSON holds: six digits of each number, fields by their names."""
    match value:
        case bool() | np.bool_():
            return bool(value)
        case str() | None:
            return value
        case int() | np.integer():
            return int(value)
        case float() | np.floating():
            return float(f"{value:.6g}") if math.isfinite(value) else str(value)
        case np.ndarray():
            return plain(value.tolist())
        case Mapping():
            return {str(key): plain(entry) for key, entry in value.items()}
        case list() | tuple():
            return [plain(entry) for entry in value]
    return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}


def differences(
    stored: Any, found: Any, place: str = "", relative: float = RELATIVE, absolute: float = ABSOLUTE
) -> Iterator[str]:
    """Yield what differs between two results, beyond the last digits."""
    if isinstance(stored, dict) and isinstance(found, dict):
        for key in sorted(stored.keys() | found.keys()):
            yield from differences(stored.get(key), found.get(key), f"{place}/{key}", relative, absolute)
    elif isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        for index, (one, other) in enumerate(zip(stored, found, strict=True)):
            yield from differences(one, other, f"{place}/{index}", relative, absolute)
    elif isinstance(stored, float) and isinstance(found, float):
        if not math.isclose(stored, found, rel_tol=relative, abs_tol=absolute) and not (
            math.isnan(stored) and math.isnan(found)
        ):
            yield f"{place}: {stored:.6g} was stored, {found:.6g} found"
    elif stored != found:
        yield f"{place}: {stored!r} was stored, {found!r} found"


def changed(file: Path, name: str, found: Any) -> list[str]:
    """Return what differs from what a file holds under a name."""
    stored = json.loads(file.read_text())[name] if file.exists() else None
    return list(differences(stored, json.loads(json.dumps(plain(found)))))


def store(file: Path, name: str, found: Any) -> None:
    """Store what was found, beside what the file holds under other names."""
    held = json.loads(file.read_text()) if file.exists() else {}
    held[name] = plain(found)
    file.parent.mkdir(exist_ok=True)
    lines = (f"{json.dumps(key)}: {json.dumps(held[key])}" for key in sorted(held))
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n")
