"""Readers and writers of recordings; every reader yields a Track."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.logs.formats.csv.writer import write_track_csv as write_track_csv
    from mavcompass.logs.formats.tlog.frames import TlogWriter as TlogWriter
    from mavcompass.logs.reading import read_track as read_track
    from mavcompass.logs.reading import read_tracks as read_tracks

__getattr__, __dir__ = door(
    __name__,
    {
        "read_track": "reading",
        "read_tracks": "reading",
        "TlogWriter": "formats.tlog.frames",
        "write_track_csv": "formats.csv.writer",
    },
)
