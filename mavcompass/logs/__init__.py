"""Readers and writers of recordings; every reader yields a Track."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavcompass.logs.formats.csv.writer import write_track_csv as write_track_csv
    from mavcompass.logs.formats.tlog.writer import TlogWriter as TlogWriter
    from mavcompass.logs.reading import read_track as read_track
    from mavcompass.logs.reading import read_tracks as read_tracks

_PUBLIC = {
    "read_track": "mavcompass.logs.reading",
    "read_tracks": "mavcompass.logs.reading",
    "TlogWriter": "mavcompass.logs.formats.tlog.writer",
    "write_track_csv": "mavcompass.logs.formats.csv.writer",
}


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_PUBLIC[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(_PUBLIC)
