"""ArduPilot's own log (DataFlash): binary (.bin) or turned into text (.log)."""

from __future__ import annotations

from pathlib import Path

from mavcompass.track import Track

NAME = "DataFlash (.bin, .log)"
SUFFIXES = (".bin", ".log")
_MAGIC = b"\xa3\x95"


def recognises(head: bytes) -> bool:
    """Tell whether a file begins with a record, or with the text of one."""
    return head.startswith(_MAGIC) or _begins_as_text(head)


def _begins_as_text(head: bytes) -> bool:
    return b"\0" not in head and (head.startswith((b"FMT,", b"PARM,")) or b"\nFMT," in head)


def read(path: Path, head: bytes) -> dict[int, Track]:
    """Read the one vehicle of the log."""
    from mavcompass.logs.formats.dataflash.reader import read_dataflash

    text = _begins_as_text(head) or (path.suffix.lower() == ".log" and _MAGIC not in head)
    return {1: read_dataflash(path, text=text)}
