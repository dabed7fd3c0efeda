"""PX4's own log (ULog, .ulg)."""

from __future__ import annotations

from pathlib import Path

from mavcompass.track import Track

NAME = "ULog (.ulg)"
SUFFIXES = (".ulg",)
_MAGIC = b"ULog\x01\x12\x35"


def recognises(head: bytes) -> bool:
    """Tell whether a file begins as every ULog does."""
    return head.startswith(_MAGIC)


def read(path: Path, head: bytes) -> dict[int, Track]:
    """Read the one vehicle of the log."""
    from mavcompass.logs.formats.ulog.reader import read_ulog

    return {1: read_ulog(path)}
