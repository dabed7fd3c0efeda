"""Telemetry logs (.tlog): MAVLink frames with the time at which each was heard."""

from __future__ import annotations

from pathlib import Path

from mavcompass.messages.message import FRAME_STARTS
from mavcompass.track import Track

NAME = "telemetry log (.tlog)"
SUFFIXES = (".tlog",)
# The second byte of a time between 2005 and 2041.
_OUR_TIMES = range(4, 8)


def recognises(head: bytes) -> bool:
    """Tell whether a file begins with a time (microseconds of Unix time, eight bytes) and a frame.

    One of the time's first two bytes may be damaged.
    """
    return len(head) > 8 and head[8] in FRAME_STARTS and (head[0] == 0 or head[1] in _OUR_TIMES)


def read(path: Path, head: bytes) -> dict[int, Track]:
    """Read every vehicle; what its autopilot's own log beside the file knows better is taken from there."""
    from mavcompass.logs.formats.tlog.companion import complete
    from mavcompass.logs.formats.tlog.reader import read_tlog

    return {system: complete(track, path) for system, track in read_tlog(path).items()}
