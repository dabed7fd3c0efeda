"""Readers and writers of recordings; every reader yields a Track."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavcompass.logs.reading import read_track as read_track
    from mavcompass.logs.reading import read_tracks as read_tracks
    from mavcompass.logs.tlog_writer import TlogWriter as TlogWriter
    from mavcompass.logs.track_csv import write_track_csv as write_track_csv

_PUBLIC = {
    "read_track": "mavcompass.logs.reading",
    "read_tracks": "mavcompass.logs.reading",
    "TlogWriter": "mavcompass.logs.tlog_writer",
    "write_track_csv": "mavcompass.logs.track_csv",
}


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_PUBLIC[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(_PUBLIC)
