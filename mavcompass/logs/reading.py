"""read_track: any recording becomes a Track."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from mavcompass.credible import with_credible_readings
from mavcompass.errors import BadRecording, NoMagnetometer, UsageError
from mavcompass.files import require_file
from mavcompass.installation.doors import modules_in
from mavcompass.logs import formats
from mavcompass.track import Track
from mavcompass.track_builder import with_sound_times

_LOOKED_AT = 4096


def read_track(path: str | Path) -> Track:
    """Read a recording: of several vehicles in one file the one with the most magnetometer readings.

    The content decides on the format, and the suffix where the content does not. Raises UsageError for
    a file that is not there, BadRecording for one that cannot be used.
    """
    tracks = read_tracks(path)
    best = max(tracks, key=lambda system: sum(len(c.reported) for c in tracks[system].compasses.values()))
    track = tracks[best]
    if len(tracks) > 1:
        others = ", ".join(str(system) for system in tracks if system != best)
        note = f"The recording holds {len(tracks)} vehicles; this is system {best} (others: {others})."
        track = replace(track, notes=(*track.notes, note))
    return track


def read_tracks(path: str | Path) -> dict[int, Track]:
    """Read every vehicle of a recording, by MAVLink system id (1 where the format knows no ids).

    Raises as `read_track` does.
    """
    path = Path(path)
    head = _head(path)
    reader = _recognise(path, head)
    # Damaged numbers overflow or are signalling nans: they are sorted out, not warned of.
    with np.errstate(invalid="ignore", over="ignore"):
        read: dict[int, Track] = reader.read(path, head)
        tracks = {s: with_sound_times(with_credible_readings(track)) for s, track in read.items()}
    found = {system: track for system, track in tracks.items() if track.compasses}
    if not found:
        told = next(iter(tracks.values()))
        raise NoMagnetometer(
            f"{path} holds no usable magnetometer. {' '.join(told.notes)}",
            "Check the compass and the vehicle's clock, and record again.",
            told.parameters,
        )
    return found


@cache
def known_formats() -> tuple[ModuleType, ...]:
    """Return the rooms of `formats/`; see there what each offers."""
    return tuple(modules_in(formats))


def _head(path: Path) -> bytes:
    require_file(path)
    try:
        with path.open("rb") as file:
            return file.read(_LOOKED_AT)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}.", "Check its permissions.") from None


def _recognise(path: Path, head: bytes) -> ModuleType:
    """Tell a recording's format, by its content or else its suffix."""
    *names, last = (reader.NAME for reader in known_formats())
    remedy = f"Give a {', '.join(names)} or {last}."
    if not head:
        raise BadRecording(f"{path} is empty.", remedy)
    by_content = (reader for reader in known_formats() if reader.recognises(head))
    by_suffix = (reader for reader in known_formats() if path.suffix.lower() in reader.SUFFIXES)
    found = next(by_content, None) or next(by_suffix, None)
    if found is None:
        raise BadRecording(f"{path} is no recording of a known format.", remedy)
    return found
