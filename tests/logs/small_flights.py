"""One small flight in each format: a vehicle that turns by 90 degrees four times, and its parameters."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dataflash_builder import ATT, GPS, IMU, MAG, MSG, PARM, Log
from recorded_frames import Recording, attitude, dialect, heartbeat, parameter
from ulog_builder import ULogFile

HZ, SECONDS, BOOT_S = 10, 48, 20.0
COUNT = HZ * SECONDS
_FIELD_NED = (232.0, 52.7, 529.0)


@dataclass(frozen=True)
class Flight:
    """Hold what every format can say: a vehicle that turns by 90 degrees four times, and its parameters."""

    time_s: np.ndarray = field(default_factory=lambda: BOOT_S + np.arange(COUNT) / HZ)
    mag: np.ndarray = field(default_factory=lambda: _turning()[0])
    gyro: np.ndarray = field(default_factory=lambda: _turning()[1])
    acc: np.ndarray = field(default_factory=lambda: np.tile([0.0, 0.0, -9.80665], (COUNT, 1)))
    yaw: np.ndarray = field(default_factory=lambda: _turning()[2])
    parameters: dict[str, float] = field(
        default_factory=lambda: {f"COMPASS_OFS_{axis}": 5.0 * k for k, axis in enumerate("XYZ", 1)}
    )


def _turning() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    since = np.arange(COUNT) / HZ
    rate = np.where(since % 10.0 >= 7.0, math.radians(30.0), 0.0)
    yaw = np.cumsum(rate) / HZ
    north, east, down = _FIELD_NED
    ahead = north * np.cos(yaw) + east * np.sin(yaw) + 60.0
    right = east * np.cos(yaw) - north * np.sin(yaw) - 40.0
    mag = np.stack([ahead, right, np.full(COUNT, down)], axis=1) + np.random.default_rng(1).normal(
        0, 2, (COUNT, 3)
    )
    gyro = np.stack([0.0 * rate, 0.0 * rate, rate], axis=1)
    return mag, gyro, (yaw + np.pi) % (2 * np.pi) - np.pi


# --- writers: numbers are brought to what the format holds --------------------------------------------


def _whole(value: float, bits: int, signed: bool = True) -> int:
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return low if math.isnan(value) else int(min(max(value, low), high))


def tlog(flight: Flight) -> bytes:
    """Write it as telemetry; the ground station's clock is a good one."""
    log = Recording()
    for name, value in flight.parameters.items():
        log.add(0.0, parameter(name, value, index=1))
    for k, moment in enumerate(flight.time_s.tolist()):
        if k % HZ == 0:
            log.add(k / HZ, heartbeat("rover"))
        field_mgauss = [_whole(v, 16) for v in flight.mag[k]]
        rates = [_whole(v * 1e3, 16) for v in flight.gyro[k]]
        force = [_whole(v / 9.80665e-3, 16) for v in flight.acc[k]]
        stamp = _whole(moment * 1e6, 64, signed=False)
        log.add(k / HZ + 0.02, dialect.MAVLink_raw_imu_message(stamp, *force, *rates, *field_mgauss))
        boot = _whole(moment * 1e3, 32, signed=False) * 1e-3
        log.add(k / HZ + 0.021, attitude(boot, yaw=float(flight.yaw[k])))
    return log.content


def binary(flight: Flight) -> bytes:
    """Write it as ArduPilot's own log."""
    log = Log(MAG, IMU, ATT, PARM, MSG, GPS).add("MSG", 0, "ArduRover V4.6.3")
    for name, value in flight.parameters.items():
        log.add("PARM", 1_000_000, name, value)
    for kind, values in _records(flight):
        log.add(kind, *values)
    return log.content


def text(flight: Flight) -> bytes:
    """Write it as ArduPilot's own log, turned into text."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    for number, name, characters, columns in (MAG, IMU, ATT, PARM):
        length = 3 + struct.calcsize("<" + "".join({"c": "h", "N": "16s"}.get(c, c) for c in characters))
        lines.append(f"FMT, {number}, {length}, {name}, {characters}, {columns}")
    lines += [f"PARM, 1000000, {name}, {value!r}" for name, value in flight.parameters.items()]
    lines += [f"{kind}, {', '.join(repr(value) for value in values)}" for kind, values in _records(flight)]
    return "\n".join(lines).encode() + b"\n"


def _records(flight: Flight) -> Iterator[tuple[str, list[Any]]]:
    for k, moment in enumerate(flight.time_s.tolist()):
        stamp = _whole(moment * 1e6, 64, signed=False)
        offsets = [_whole(v, 16) for v in list(flight.parameters.values())[:3]]
        offsets += [0] * (3 - len(offsets))
        yield "MAG", [stamp, 0, *(_whole(v, 16) for v in flight.mag[k]), *offsets]
        yield "IMU", [stamp, 0, *flight.gyro[k].tolist(), *flight.acc[k].tolist()]
        yield "ATT", [stamp, 0, 0, 0, 0, 0.0, math.degrees(float(flight.yaw[k])) % 360.0, 0.0]


def ulog(flight: Flight) -> bytes:
    """Write it as PX4's own log."""
    log = ULogFile().topic("sensor_mag", "uint32_t device_id", "float x", "float y", "float z")
    log.topic("vehicle_attitude", "float[4] q")
    log.topic("sensor_combined", "float[3] gyro_rad", "float[3] accelerometer_m_s2")
    log.parameter("CAL_MAG0_ID", 9).parameter("CAL_MAG0_ROT", 0)
    for name, value in flight.parameters.items():
        log.parameter(_PX4.get(name, name), value * (1e-3 if "OFS" in name else 1.0))
    for k, moment in enumerate(flight.time_s.tolist()):
        stamp = _whole(moment * 1e6, 64, signed=False)
        half = 0.5 * float(flight.yaw[k])
        log.add("sensor_mag", stamp, 9, *(flight.mag[k] * 1e-3).tolist())
        log.add("sensor_combined", stamp, *flight.gyro[k].tolist(), *flight.acc[k].tolist())
        log.add("vehicle_attitude", stamp, math.cos(half), 0.0, 0.0, math.sin(half))
    return b"".join(log.parts)


_PX4 = {f"COMPASS_OFS_{axis}": f"CAL_MAG0_{axis}OFF" for axis in "XYZ"}
_PX4 |= {f"COMPASS_DIA_{axis}": f"CAL_MAG0_{axis}SCALE" for axis in "XYZ"}
_PX4 |= {f"COMPASS_ODI_{axis}": f"CAL_MAG0_{axis}ODIAG" for axis in "XYZ"}
_PX4 |= {f"COMPASS_MOT_{axis}": f"CAL_MAG0_{axis}COMP" for axis in "XYZ"}


def table(flight: Flight) -> bytes:
    """Write it as a Track CSV."""
    names = ["time_s", *(f"mag_{a}_mgauss" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
    names += [f"acc_{a}_mps2" for a in "xyz"]
    columns = (flight.mag, flight.gyro, flight.acc)
    rows = np.column_stack([flight.time_s, *(one[: len(flight.time_s)] for one in columns)]).tolist()
    return "\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows)]).encode() + b"\n"


WRITERS: dict[str, Callable[[Flight], bytes]] = {
    ".tlog": tlog, ".bin": binary, ".log": text, ".ulg": ulog, ".csv": table
}  # fmt: skip
