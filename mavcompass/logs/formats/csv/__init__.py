"""Track CSV: a header row with units in its names, any subset of the columns, from anywhere."""

from __future__ import annotations

from pathlib import Path

from mavcompass.track import Track

NAME = "Track CSV (.csv)"
SUFFIXES = (".csv",)


def recognises(head: bytes) -> bool:
    """Tell whether a file begins with a line of column names, time_s among them."""
    first = head.split(b"\n", 1)[0].removeprefix(b"\xef\xbb\xbf")
    return b"\0" not in head and b"time_s" in [name.strip() for name in first.split(b",")]


def read(path: Path, head: bytes) -> dict[int, Track]:
    """Read the one vehicle of the file."""
    from mavcompass.logs.formats.csv.reader import read_track_csv

    return {1: read_track_csv(path)}
