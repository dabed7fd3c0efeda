"""Damage to recordings, and what a reader must never make of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from dataflash_builder import BAT, GPS, Log
from recorded_frames import Recording, scaled_imu, sys_status
from small_flights import WRITERS, Flight

from mavcompass.errors import BadRecording
from mavcompass.logs import read_track, write_track_csv
from mavcompass.logs.formats.tlog.messages import ALL_FIELDS, read_messages
from mavcompass.track import Series, Track

CHECKED = ("RAW_IMU", "ATTITUDE", "PARAM_VALUE", "SYS_STATUS", "SCALED_IMU2", "HEARTBEAT")


def originals(folder: Path) -> dict[str, bytes]:
    """Make a few seconds of a flight in each format, in a new folder; return their contents by suffix."""
    folder.mkdir(exist_ok=True)
    whole = Flight()
    flight = replace(whole, time_s=whole.time_s[:60])
    contents = {suffix: write(flight) for suffix, write in WRITERS.items()}
    beside, log = Recording(), Log(GPS, BAT)
    for n in range(6):
        beside.add(7.0 + n, sys_status(1000 + n), version=1 + n % 2)
        beside.add(7.0 + n, scaled_imu(26.0 + n, (210 + n, 3, 4), "2"), version=1 + n % 2)
        now = 20_000_000 + n * 1_000_000
        log.add("BAT", now, 0, 12.0, 0.1 * n)
        log.add("GPS", now, 3, 1000 * n, 2300, 9, 100, 479_000_000, 80_000_000, 0, 0.0, 0.0, 0.0)
    contents[".tlog"] += beside.content
    contents[".bin"] += log.content
    contents[".log"] += b"FMT, 21, 76, UNIT, QbZ, TimeUS,Id,Label\nUNIT, 0, 71, Gauss\n"
    (folder / "original.tlog").write_bytes(contents[".tlog"])
    write_track_csv(read_track(folder / "original.tlog"), folder / "original.csv")
    return contents | {".csv": (folder / "original.csv").read_bytes()}


def flip_bits(content: bytes, rng: np.random.Generator) -> bytes:
    """Flip one to twenty bits anywhere."""
    out = bytearray(content)
    for place in rng.integers(0, len(out), rng.integers(1, 21)):
        out[place] ^= 1 << rng.integers(8)
    return bytes(out)


def overwrite(content: bytes, rng: np.random.Generator) -> bytes:
    """Put noise or one value over a stretch."""
    first = int(rng.integers(0, len(content)))
    count = int(min(rng.integers(1, 400), len(content) - first))
    noise = (
        rng.bytes(count) if rng.random() < 0.5 else bytes((int(rng.choice([0, 0xFF, 0xFD, 0xA3])),)) * count
    )
    return content[:first] + noise + content[first + count :]


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    """Take away the end, the beginning or a stretch in the middle."""
    first, last = sorted(int(place) for place in rng.integers(0, len(content) + 1, 2))
    return [content[:first], content[first:], content[:first] + content[last:]][int(rng.integers(3))]


def splice(content: bytes, rng: np.random.Generator) -> bytes:
    """Put a stretch of the recording into another place of it, or the whole behind itself."""
    first, last, place = (int(n) for n in rng.integers(0, len(content) + 1, 3))
    piece = content if rng.random() < 0.1 else content[min(first, last) : max(first, last)][:3000]
    return content[:place] + piece + content[place:]


# What a chance byte hardly makes of a text: numbers beyond any type, brackets beyond any stack.
WORDS = (b"\0", b"\xff" * 4, b"nan", b"1e30", b"-inf", b"9" * 400, b"null", b"{}", b"[" * 2000, b"\n")


def spell(content: bytes, rng: np.random.Generator) -> bytes:
    """Put one of `WORDS` anywhere."""
    place = int(rng.integers(0, len(content) + 1))
    return content[:place] + WORDS[int(rng.integers(len(WORDS)))] + content[place:]


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    flip_bits, overwrite, cut, splice, spell
)  # fmt: skip


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """Apply one to three kinds of damage."""
    for _ in range(int(rng.integers(1, 4))):
        if content:
            content = MUTATIONS[int(rng.integers(len(MUTATIONS)))](content, rng)
    return content


def read_or_refuse(path: Path) -> Track | None:
    """Read a damaged recording; None where it is refused in the way that a person is told.

    Raises AssertionError for a Track that breaks its own promises; any other exception is a defect.
    """
    try:
        track = read_track(path)
    except BadRecording as refusal:
        assert refusal.what and refusal.remedy
        return None
    columns = [series for name in track.__slots__ if isinstance(series := getattr(track, name), Series)]
    for series in [*columns, *(compass.reported for compass in track.compasses.values())]:
        assert len(series) == len(series.values) > 0
        assert bool(np.isfinite(series.time_s).all()), "a time that is no number"
        assert bool((np.diff(series.time_s) >= 0.0).all()), "time goes back"
    for instance, compass in track.compasses.items():
        assert track.raw_field(instance).shape == (len(compass.reported), 3)
        assert compass.in_force[0].from_s == -math.inf
    return track


def checked_rows(path: Path) -> set[tuple[str, bytes]]:
    """Return every message that was read from a telemetry log, as (name, content)."""
    senders = read_messages(path, dict.fromkeys(CHECKED, ALL_FIELDS)).senders
    return {
        (name, row.tobytes())
        for by_name in senders.values()
        for name, messages in by_name.items()
        for row in messages.rows
    }
