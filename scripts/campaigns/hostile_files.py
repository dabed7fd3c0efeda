"""Make hostile recordings: one small flight in each format, with what a clock, a sensor, a writer or an
attacker may put there; `hostile_recordings.py` lets every command have each.
"""

from __future__ import annotations

import math
import os
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from campaign import borrow

borrow("logs")
from dataflash_builder import MAG, PARM, Log  # noqa: E402
from recorded_frames import T0_US, attitude, dialect, frame, parameter  # noqa: E402
from small_flights import BOOT_S, COUNT, WRITERS, Flight  # noqa: E402

GIGABYTES = 3 << 30


# --- what is done to the flight ----------------------------------------------------------------------

_MOMENTS = Flight().time_s


def _clocks() -> Iterator[tuple[str, np.ndarray]]:
    for leap in (1e3, 1e5, 1e7, 1e9, 1e13, 1e17):
        for place, where in (("first", 0), ("middle", COUNT // 2), ("last", COUNT - 1)):
            times = _MOMENTS.copy()
            times[where] += leap
            yield f"one time leaps by {leap:g}, the {place}", times
        yield f"the second half is {leap:g} later", _MOMENTS + leap * (np.arange(COUNT) >= COUNT // 2)
        yield f"every other time is {leap:g} later", _MOMENTS + leap * (np.arange(COUNT) % 2)
        yield f"each time is {leap:g} after the last", BOOT_S + leap * np.arange(COUNT)
    rng = np.random.default_rng(7)
    yield "times by chance, to 1e9", rng.uniform(0.0, 1e9, COUNT)
    yield "times by chance over all magnitudes", 10.0 ** rng.uniform(-6.0, 18.0, COUNT)
    yield "times that double", 2.0 ** np.minimum(np.arange(COUNT), 60)
    for value in (0.0, BOOT_S, 1e9, 1e17):
        yield f"all times {value:g}", np.full(COUNT, value)
    yield "two times only", np.where(np.arange(COUNT) < COUNT // 2, 10.0, 20.0)
    yield "a microsecond apart", BOOT_S + 1e-6 * np.arange(COUNT)
    yield "a nanosecond apart", BOOT_S + 1e-9 * np.arange(COUNT)
    yield "backwards", _MOMENTS[::-1].copy()
    yield "saw teeth", BOOT_S + np.arange(COUNT) % 7
    yield "restarts at every tenth", BOOT_S + 30.0 * (np.arange(COUNT) % 10)
    yield "no number among them", np.where(np.arange(COUNT) == 99, np.nan, _MOMENTS)


def _parameters() -> Iterator[tuple[str, dict[str, float]]]:
    for quantity in ("OFS", "DIA", "ODI", "MOT"):
        for value in (1e38, -1e38, math.nan, math.inf, 1e-38, 1e6, 0.0):
            given = {f"COMPASS_{quantity}_{axis}": value for axis in "XYZ"}
            yield f"{quantity} {value:g}", {"COMPASS_MOTCT": 2.0, **given}
    yield "DIA singular", {f"COMPASS_{q}_{axis}": 1.0 for q in ("DIA", "ODI") for axis in "XYZ"}
    yield "DIA of one axis only", {"COMPASS_DIA_X": 1.0, "COMPASS_DIA_Y": 0.0, "COMPASS_DIA_Z": 0.0}
    for name in ("COMPASS_SCALE", "COMPASS_MOTCT", "COMPASS_ORIENT", "COMPASS_DEV_ID", "CAL_MAG0_ROT"):
        for value in (1e38, -1.0, math.nan):
            yield f"{name} {value:g}", {name: value}


def _numbers() -> Iterator[tuple[str, Flight]]:
    flight = Flight()
    for name in ("mag", "gyro", "acc"):
        for value in (0.0, 1.0, math.nan, math.inf, 1e30, 1e38, 3e7, -32768.0, 1e-30):
            yield f"{name} {value:g}", replace(flight, **{name: np.full((COUNT, 3), value)})
        rng = np.random.default_rng(9)
        wild = 10.0 ** rng.uniform(-9.0, 6.9, (COUNT, 3)) * rng.choice([-1, 1], (COUNT, 3))
        yield f"{name} over all magnitudes", replace(flight, **{name: wild})
    yield "mag on one axis", replace(flight, mag=flight.mag * (1.0, 0.0, 0.0))
    yield "mag that follows the gyro", replace(flight, mag=flight.gyro * 1e3 + 1.0)
    yield "one reading", replace(flight, time_s=_MOMENTS[:1])
    yield "two readings", replace(flight, time_s=_MOMENTS[:2])


# --- what is done to the file -------------------------------------------------------------------------


def _message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


Changes = Iterator[tuple[str, Callable[[], bytes]]]


def _of_tlog(good: bytes) -> Changes:
    stamp = T0_US.to_bytes(8, "big")
    imu = dialect.MAVLink_raw_imu_message(1, 0, 0, -1000, 0, 0, 0, 200, 0, -500)

    def recorded(count: int, one: Callable[[int], bytes]) -> Callable[[], bytes]:
        return lambda: good + b"".join(stamp + one(n) for n in range(count))

    yield (
        "65 000 senders",
        recorded(65_000, lambda n: frame(imu, system=1 + n % 255, component=n // 255 % 256)),
    )
    yield "20 000 parameters", recorded(20_000, lambda n: frame(parameter(f"P{n}", float(n))))
    steps = recorded(20_000, lambda n: frame(parameter("COMPASS_OFS_X", float(n % 500))))
    yield "20 000 steps of an offset", steps
    told = stamp + frame(parameter("COMPASS_OFS_X", 1.0, index=1))
    yield "100 000 times one parameter", lambda: good + told * 100_000
    yield "30 000 times one message", lambda: good + (stamp + frame(imu)) * 30_000
    yield "nothing but frame starts", lambda: good + b"\xfd" * 8_000_000
    yield "nothing but starts of known frames", lambda: good + b"\xfe" * 4_000_000
    yield "time stamps without frames", lambda: good[:8] * 500_000
    times = range(640)
    yield (
        "log times of all magnitudes",
        lambda: (
            b"".join((1 << n % 64).to_bytes(8, "big") + frame(attitude(20.0 + n * 0.1)) for n in times) + good
        ),
    )
    yield "unknown messages", lambda: good + (stamp + bytes.fromhex("fd00000000010199990100ff")) * 200_000


def _of_bin(good: bytes) -> Changes:
    def parameters() -> bytes:
        log = Log(MAG, PARM)
        for n in range(100_000):
            log.add("PARM", n, f"P{n}", float(n))
        return log.mags(50).content

    def formats() -> bytes:
        kinds = ((n % 250, f"Q{n % 99}", "QBhh", "TimeUS,I,A,B") for n in range(5_000))
        return good + b"".join(Log(kind).content for kind in kinds)

    yield "60 000 logs of nothing", lambda: good + Log().content * 60_000
    yield "thirty logs", lambda: good * 30
    yield "nothing but headers", lambda: good + b"\xa3\x95" * 4_000_000
    yield "formats that change", formats
    yield "100 000 parameters", parameters
    yield "lengths that lie", lambda: good.replace(bytes((0x80, 10, 24)), bytes((0x80, 10, 255)))


def _of_log(good: bytes) -> Changes:
    formats = (b"FMT, %d, 5, A%d, BB, A,B\n" % (n % 250, n % 999) for n in range(60_000))
    first = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    yield "a line of 60 MB", lambda: good + b"MAG, " + b"1" * 60_000_000
    yield "a line of 60 MB, then more", lambda: good + b"MAG, " + b"1," * 30_000_000 + b"\n" + good
    yield "lines of nothing", lambda: good + b"\n" * 5_000_000
    yield "a number of many digits", lambda: good + b"MAG, " + b"9" * 60_000 + b", 0, 1, 2, 3, 0, 0, 0\n"
    yield "60 000 formats", lambda: good + b"".join(formats)
    yield "20 000 logs", lambda: first * 20_000 + good


def _of_ulg(good: bytes) -> Changes:
    def written(count: int, kind: bytes, body: Callable[[int], bytes]) -> Callable[[], bytes]:
        return lambda: good + b"".join(_message(kind, body(n)) for n in range(count))

    added = _message(b"A", b"\0\1\0sensor_mag")
    deep = b"".join(_message(b"F", b"t%d:t%d[2] x;" % (n, n + 1)) for n in range(60))
    deep += _message(b"F", b"t60:float x;") + _message(b"F", b"sensor_mag:t0 x;")
    wide = _message(b"F", b"sensor_mag:uint8_t[65535] x;")
    offset = b"\x13float CAL_MAG0_XOFF"
    yield "lengths of 0", lambda: good + b"\0\0D" * 1_000_000
    yield "lengths of 0 of no type", lambda: good + b"\0" * 3_000_000
    yield "lengths of 65 535", lambda: good + b"\xff\xff\xff" * 1_000_000
    yield "types that nobody knows", lambda: good + _message(b"?", b"x" * 7) * 300_000
    yield "data of nobody", lambda: good + _message(b"D", b"\x77\x77" + b"x" * 6) * 300_000
    yield "a type within itself", lambda: good[:16] + _message(b"F", b"sensor_mag:sensor_mag x;") + added
    yield "types within types", lambda: good[:16] + deep + added
    yield "65 535 fields, subscribed often", lambda: good[:16] + wide + added * 3_000
    ids = (struct.pack("<BH", 0, n % 65_000) + b"sensor_mag" for n in range(100_000))
    yield "100 000 subscriptions", lambda: good + b"".join(_message(b"A", one) for one in ids)
    yield (
        "50 000 steps of an offset",
        written(50_000, b"P", lambda n: offset + struct.pack("<f", n % 500 * 1e-3)),
    )
    yield (
        "99 999 parameters",
        written(99_999, b"P", lambda n: b"\x0eint32_t P%05d" % n + struct.pack("<i", n)),
    )
    yield "appended data anywhere", lambda: good[:35] + struct.pack("<QQQ", 1 << 62, 100, 17) + good[59:]


def _of_csv(good: bytes) -> Changes:
    header, _, rows = good.partition(b"\n")
    yield "a million columns", lambda: header + b"".join(b",c%d" % n for n in range(1_000_000)) + b"\n" + rows
    yield "a thousand columns", lambda: header + b"".join(b",c%d" % n for n in range(1_000)) + b"\n" + rows
    yield "a million empty columns", lambda: header + b"," * 1_000_000 + b"\n" + rows
    yield "a line of 60 MB", lambda: good + b"1," * 30_000_000
    yield "a line of 60 MB, then more", lambda: good + b"9" * 60_000_000 + b"\n" + rows
    yield "a header of 60 MB", lambda: header + b"x" * 60_000_000 + b"\n" + rows
    yield "an open quote", lambda: header + b'\n"' + rows * 400
    yield "an open quote in the header", lambda: b'"' + good * 400
    yield "empty cells", lambda: header + b"\n" + rows + b",,,,,,,,,\n" * 1_000_000
    yield "lines of nothing", lambda: good + b"\n" * 8_000_000
    yield "old line ends", lambda: good.replace(b"\n", b"\r") * 200
    some = b"\n".join(rows.split(b"\n")[:9]) + b"\nx\n"
    yield "every tenth line bad", lambda: header + b"\n" + some * 20_000
    yield "numbers of a thousand digits", lambda: header + b"\n" + (b"9" * 1000 + b"," * 9 + b"\n") * 3_000
    yield "bytes that are no text", lambda: header + b"\n" + bytes(range(256)) * 20_000
    yield "nothing but the header", lambda: header
    yield "ten columns of one name", lambda: b",".join([b"time_s"] * 10) + b"\n" + rows


_OF_FORMAT = {".tlog": _of_tlog, ".bin": _of_bin, ".log": _of_log, ".ulg": _of_ulg, ".csv": _of_csv}
_OF_ANY: tuple[tuple[str, Callable[[bytes], bytes]], ...] = (
    ("nothing", lambda good: b""),
    ("its head only", lambda good: good[:40]),
    ("its first half", lambda good: good[: len(good) // 2 + 1]),
    ("itself twice", lambda good: good * 2),
    ("itself with a hole", lambda good: good[: len(good) // 2] + bytes(500_000) + good[len(good) // 2 :]),
    ("five megabytes of chance behind it", lambda good: good + np.random.default_rng(3).bytes(5_000_000)),
    ("five megabytes of chance", lambda good: np.random.default_rng(4).bytes(5_000_000)),
)


# --- what is no file ---------------------------------------------------------------------------------


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def _sparse(head: bytes) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.write(head)
            file.truncate(GIGABYTES)

    return make


SPECIAL: dict[str, Callable[[Path], None]] = {
    "a pipe": os.mkfifo,
    "zeros without end": lambda path: path.symlink_to("/dev/zero"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a link to nowhere": lambda path: path.symlink_to("/nowhere"),
    "a socket": _socket,
    "a folder": Path.mkdir,
}


# --- the inputs, and the commands --------------------------------------------------------------------


@dataclass(frozen=True)
class Hostile:
    """Name one hostile input, and how it is made at a path."""

    name: str
    suffix: str
    make: Callable[[Path], object]


def inputs() -> Iterator[Hostile]:
    """Yield every input; nothing is made yet."""

    def written(name: str, suffix: str, flight: Flight) -> Hostile:
        return Hostile(name, suffix, lambda path: path.write_bytes(WRITERS[suffix](flight)))

    for suffix, write in WRITERS.items():
        for name, times in _clocks():
            yield written(f"clock: {name}", suffix, Flight(time_s=times))
        if suffix != ".csv":
            for name, parameters in _parameters():
                yield written(f"parameters: {name}", suffix, Flight(parameters=parameters))
        for name, flight in _numbers():
            yield written(f"numbers: {name}", suffix, flight)
        good = write(Flight())
        for name, content in _OF_FORMAT[suffix](good):
            yield Hostile(f"file: {name}", suffix, lambda path, content=content: path.write_bytes(content()))
        for name, change in _OF_ANY:
            yield Hostile(f"file: {name}", suffix, lambda path, c=change, g=good: path.write_bytes(c(g)))
        for name, make in SPECIAL.items():
            yield Hostile(f"special: {name}", suffix, make)
        yield Hostile("special: a hole of 3 GB", suffix, _sparse(b""))
        yield Hostile("special: a flight and a hole of 3 GB", suffix, _sparse(good))
