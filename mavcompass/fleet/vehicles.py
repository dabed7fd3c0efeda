"""Tell vehicles apart that share a folder and a system id, as a fleet fresh out of the box does.

Marks of a vehicle: the calibration of its accelerometer, which is its own and hardly ever changes; the
offsets of its compass in force; the device ids of its compasses, which say type and bus: twins share them.
"""

from __future__ import annotations

import math
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Row = dict[str, Any]
_AXES = ("X", "Y", "Z")
_ACCELEROMETERS = (("INS_ACCOFFS_{}", "INS_ACCSCAL_{}"), ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE"))
_OFFSETS = tuple(f"in_force_offset_{axis.lower()}_mgauss" for axis in _AXES)


def accelerometer_mark(parameters: Mapping[str, float]) -> str | None:
    """Return a short text that is the same for the same accelerometer calibration; None without one."""
    for offset, scale in _ACCELEROMETERS:
        values = [parameters.get(name.format(axis), math.nan) for name in (offset, scale) for axis in _AXES]
        if all(map(math.isfinite, values)) and any(values[:3]):
            return f"{zlib.crc32(repr([round(value, 6) for value in values]).encode()):08x}"
    return None


@dataclass(slots=True)
class _Marks:
    accelerometer: set[str] = field(default_factory=set)
    offsets: set[tuple[int, float, float, float]] = field(default_factory=set)
    device_ids: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Marks:
        own = cls()
        for row in rows:
            offsets = [row.get(name) for name in _OFFSETS]
            if row.get("accelerometer"):
                own.accelerometer.add(row["accelerometer"])
            if None not in offsets and any(offsets):
                own.offsets.add((row["compass"], *(float(value) for value in offsets if value is not None)))
            if row.get("device_ids"):
                own.device_ids.add(row["device_ids"])
        return own

    def may_be(self, other: _Marks) -> bool:
        """Tell whether nothing speaks against one vehicle, or a mark that is its own speaks for it."""
        if self.accelerometer & other.accelerometer or self.offsets & other.offsets:
            return True
        if self.accelerometer and other.accelerometer:
            return False
        return not (self.device_ids and other.device_ids) or bool(self.device_ids & other.device_ids)

    def add(self, other: _Marks) -> None:
        self.accelerometer |= other.accelerometer
        self.offsets |= other.offsets
        self.device_ids |= other.device_ids


def told_apart(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with ", A", ", B", .. after the name that several vehicles share, the earliest first.

    Only names made of folder and system id are in doubt, and only recordings with a result have marks.
    """
    by_name: dict[str, dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row.get("named_by") == "folder":
            by_name[row["vehicle"]][row["recording"]].append(row)
    renamed: dict[str, str] = {}
    for name, recordings in by_name.items():
        groups: list[tuple[_Marks, list[str]]] = []
        for recording, own in sorted(recordings.items(), key=lambda item: (_begun(item[1]), item[0])):
            marks = _Marks.of(own)
            known = next((group for group in groups if group[0].may_be(marks)), None)
            if known is None:
                groups.append((marks, [recording]))
            else:
                known[0].add(marks)
                known[1].append(recording)
        if len(groups) > 1:
            for number, (_, members) in enumerate(groups):
                renamed |= {recording: f"{name}, {_letters(number)}" for recording in members}
    return [row | {"vehicle": renamed.get(row["recording"], row["vehicle"])} for row in rows]


def _begun(rows: Sequence[Row]) -> float:
    known = [row["recorded_unix_s"] for row in rows if row.get("recorded_unix_s") is not None]
    return min(known, default=math.inf)


def _letters(number: int) -> str:
    """Count A, B, .. Z, AA, AB, .."""
    more, last = divmod(number, 26)
    return (_letters(more - 1) if more else "") + chr(ord("A") + last)
