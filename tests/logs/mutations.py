"""Damage to recordings, and what a reader must never make of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from dataflash_builder import ATT, BAT, GPS, IMU, MAG, MSG, PARM, Log
from recorded_frames import Recording, parameter, scaled_imu, sys_status
from ulog_builder import ULogFile

from mavcompass.errors import BadRecording
from mavcompass.logs import read_track, write_track_csv
from mavcompass.logs.formats.tlog.messages import ALL_FIELDS, read_messages
from mavcompass.track import Series, Track

CHECKED = ("RAW_IMU", "ATTITUDE", "PARAM_VALUE", "SYS_STATUS", "SCALED_IMU2", "HEARTBEAT")


def originals(folder: Path) -> dict[str, bytes]:
    """Make one small recording of each format, in a new folder; return their contents by suffix."""
    folder.mkdir(exist_ok=True)
    recording = Recording()
    for axis, value in zip("XYZ", (5.0, 13.0, -18.0), strict=True):
        recording.add(0.0, parameter(f"COMPASS_OFS_{axis}", value, index=1))
    for n in range(12):
        part = Recording().fly(
            1.0, boot_s=20.0 + n, log_s=n, mag=(200 + 9 * n, 50 - 7 * n, -500), version=1 + n % 2
        )
        recording.records += part.records
        recording.add(n + 1.0, sys_status(1000 + n)).add(n + 1.0, scaled_imu(21.0 + n, (210 + n, 3, 4), "2"))
    recording.write(folder / "original.tlog")

    log = Log(MAG, IMU, ATT, PARM, MSG, GPS, BAT).add("MSG", 0, "ArduRover V4.6.3")
    for axis in "XYZ":
        log.add("PARM", 1_000_000, f"COMPASS_OFS_{axis}", 5.0)
    for n in range(60):
        now = 1_000_000 + n * 100_000
        log.add("MAG", now, 0, 200 + n, -n, -500, 5, 5, 5).add("IMU", now, 0, 0.0, 0.0, 0.1, 0.0, 0.0, -9.8)
        log.add("ATT", now, 0, 0, 0, 0, 0.0, 3.0 * n, 0.0).add("BAT", now, 0, 12.0, 0.1 * n)
        log.add("GPS", now, 3, 100 * n, 2300, 9, 100, 479_000_000, 80_000_000, 0, 0.0, 0.0, 0.0)
    log.write(folder / "original.bin")

    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    lines += ["FMT, 10, 24, MAG, QBhhhhhh, TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ"]
    lines += ["FMT, 13, 31, PARM, QNf, TimeUS,Name,Value", "FMT, 21, 76, UNIT, QbZ, TimeUS,Id,Label"]
    lines += ["UNIT, 0, 71, Gauss"] + [f"PARM, 1000000, COMPASS_OFS_{axis}, 5.0" for axis in "XYZ"]
    lines += [f"MAG, {1_000_000 + n * 100_000}, 0, {200 + n}, {-n}, -500, 5, 5, 5" for n in range(80)]
    (folder / "original.log").write_text("\n".join(lines) + "\n")

    ulog = ULogFile().topic("sensor_mag", "uint32_t device_id", "float x", "float y", "float z")
    ulog.topic("vehicle_attitude", "float[4] q").parameter("CAL_MAG0_ID", 9).parameter("CAL_MAG0_ROT", 0)
    for n in range(60):
        ulog.add("sensor_mag", 1_000_000 + n * 20_000, 9, 0.2, 0.01 * n, -0.5)
        ulog.add("vehicle_attitude", 1_000_000 + n * 20_000, 1.0, 0.0, 0.0, 0.0)
    ulog.write(folder / "original.ulg")

    write_track_csv(read_track(folder / "original.tlog"), folder / "original.csv")
    text = "\n".join((folder / "original.csv").read_text().splitlines()[:120]) + "\n"
    (folder / "original.csv").write_text(text)
    return {path.suffix: path.read_bytes() for path in sorted(folder.glob("original.*"))}


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


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (flip_bits, overwrite, cut, splice)


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
