"""read_track: any recording becomes a Track."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mavcompass.errors import BadRecording, UsageError
from mavcompass.track import Track

_ULOG_MAGIC = b"ULog\x01\x12\x35"
_DATAFLASH_MAGIC = b"\xa3\x95"
_MAVLINK_MAGIC = (0xFD, 0xFE)
_LOOKED_AT = 4096
_FORMATS = "telemetry log (.tlog), DataFlash (.bin, .log), ULog (.ulg) or Track CSV (.csv)"


def read_track(path: str | Path) -> Track:
    """Read a recording: of several vehicles in one file the one with the most magnetometer readings.

    The content decides on the format, and the suffix where the content does not. Raises UsageError for
    a file that is not there, BadRecording for one that cannot be used.
    """
    tracks = read_tracks(path)
    best = max(tracks, key=lambda system: sum(len(c.reported) for c in tracks[system].compasses.values()))
    track = tracks[best]
    if len(tracks) > 1:
        from dataclasses import replace

        others = ", ".join(str(system) for system in tracks if system != best)
        note = f"The recording holds {len(tracks)} vehicles; this is system {best} (others: {others})."
        track = replace(track, notes=(*track.notes, note))
    return track


def read_tracks(path: str | Path) -> dict[int, Track]:
    """Read every vehicle of a recording, by MAVLink system id (1 where the format knows no ids).

    Raises as `read_track` does.
    """
    path = Path(path)
    kind = recognise(path)
    # Damaged numbers overflow or are signalling nans: they are sorted out, not warned of.
    with np.errstate(invalid="ignore", over="ignore"):
        return _read(path, kind)


def _read(path: Path, kind: str) -> dict[int, Track]:
    if kind == "tlog":
        from mavcompass.logs.companion import complete
        from mavcompass.logs.formats.tlog.reader import read_tlog

        return {system: complete(track, path) for system, track in read_tlog(path).items()}
    if kind == "ulog":
        from mavcompass.logs.formats.ulog.reader import read_ulog

        return {1: read_ulog(path)}
    if kind == "csv":
        from mavcompass.logs.formats.csv.track_csv import read_track_csv

        return {1: read_track_csv(path)}
    from mavcompass.logs.formats.dataflash.reader import read_dataflash

    return {1: read_dataflash(path, text=kind == "dataflash text")}


def recognise(path: Path) -> str:
    """Tell a recording's format: tlog, dataflash, dataflash text, ulog or csv.

    Raises UsageError for a file that is not there or a folder, BadRecording for one of no known format.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_LOOKED_AT)
    except FileNotFoundError:
        raise UsageError(f"There is no file {path}.", "Check the name.") from None
    except IsADirectoryError:
        raise UsageError(f"{path} is a folder.", "Give one recording in it.") from None
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}.", "Check its permissions.") from None
    if not head:
        raise BadRecording(f"{path} is empty.", f"Give a {_FORMATS}.")
    return _by_content(head) or _by_suffix(path, head)


def _by_content(head: bytes) -> str | None:
    if head.startswith(_ULOG_MAGIC):
        return "ulog"
    if head.startswith(_DATAFLASH_MAGIC):
        return "dataflash"
    if len(head) > 8 and head[8] in _MAVLINK_MAGIC:
        return "tlog"
    if b"\0" not in head:
        first = head.split(b"\n", 1)[0].removeprefix(b"\xef\xbb\xbf")
        names = [name.strip() for name in first.split(b",")]
        if b"time_s" in names:
            return "csv"
        if names[0] in (b"FMT", b"PARM") or b"\nFMT," in head:
            return "dataflash text"
    return None


def _by_suffix(path: Path, head: bytes) -> str:
    text = _DATAFLASH_MAGIC not in head
    kinds = {
        ".tlog": "tlog",
        ".bin": "dataflash",
        ".log": "dataflash text" if text else "dataflash",
        ".ulg": "ulog",
        ".csv": "csv",
    }
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise BadRecording(f"{path} is no recording of a known format.", f"Give a {_FORMATS}.")
    return kind
