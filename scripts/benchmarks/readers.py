"""Measure the readers of recordings beside pymavlink's and pyulog's, in one run on the same files.

    scripts/bench readers [-- -k DataFlash]

The telemetry log and the DataFlash log are made here, with the mix of messages that a vehicle sends;
recordings of the shared data are measured too where they are there. The best of three runs by processor time
counts, of pymavlink's the only one.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
SHARED = Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data")
MADE_MESSAGES = 120_000
TIMER = "time.process_time"
RUNS = 3
STEP_MESSAGES = 12  # of one step of the made telemetry log
WHOLE, NEEDED = "pymavlink recv_match()", "pymavlink recv_match(type=needed)"
COLUMNS, TRACK = "mavcompass: checked messages as columns", "mavcompass: Track of all needed columns"
CHECKS = tuple(
    {
        "what": f"{what}, times pymavlink's recv_match()",
        "of": f"{what} made: {WHOLE}",
        "over": f"{what} made: {TRACK}",
        "at_least": ratio,
    }
    for what, ratio in (("telemetry log", 20.0), ("DataFlash", 15.0))
)
FILES = {
    "telemetry log made": "made.tlog",
    "DataFlash made": "made.bin",
    **{f"telemetry log {p.parent.name}": str(p) for p in SHARED.glob("real/*/flight.tlog")},
    **{f"telemetry log {p.name}": str(p) for p in SHARED.glob("*/copter*.tlog")},
    **{f"DataFlash {p.name}": str(p) for p in SHARED.glob("*/copter*.BIN")},
    **{f"ULog {p.name}": str(p) for p in SHARED.glob("real/*/*.ulg")},
}


def of_tlog(path: Path) -> dict[str, Callable[[], Any]]:
    """Return the readers of a telemetry log."""
    from pymavlink import mavutil

    from mavcompass.logs.formats.tlog.messages import read_messages
    from mavcompass.logs.formats.tlog.reader import WANTED, read_tlog

    return {
        WHOLE: lambda: _drained(mavutil.mavlink_connection(str(path)), None),
        NEEDED: lambda: _drained(mavutil.mavlink_connection(str(path)), list(WANTED)),
        COLUMNS: lambda: read_messages(path, WANTED),
        TRACK: lambda: read_tlog(path),
    }


def of_dataflash(path: Path) -> dict[str, Callable[[], Any]]:
    """Return the readers of a DataFlash log."""
    from pymavlink import DFReader

    from mavcompass.logs.formats.dataflash.reader import WANTED, read_dataflash
    from mavcompass.logs.formats.dataflash.records import read_records

    return {
        WHOLE: lambda: _drained(DFReader.DFReader_binary(str(path)), None),
        NEEDED: lambda: _drained(DFReader.DFReader_binary(str(path)), list(WANTED)),
        COLUMNS: lambda: read_records(path, WANTED),
        TRACK: lambda: read_dataflash(path),
    }


def of_ulog(path: Path) -> dict[str, Callable[[], Any]]:
    """Return the readers of a ULog."""
    from pyulog import ULog

    from mavcompass.logs.formats.ulog.reader import read_ulog

    return {"pyulog ULog()": lambda: ULog(str(path)), TRACK: lambda: read_ulog(path)}


READERS = {"telemetry log": of_tlog, "DataFlash": of_dataflash, "ULog": of_ulog}
NAMES = [
    f"{file}: {reader}"
    for file in FILES
    for reader in (("pyulog ULog()", TRACK) if file.startswith("ULog") else (WHOLE, NEEDED, COLUMNS, TRACK))
]


def _drained(log: Any, types: list[str] | None) -> None:
    while log.recv_match(type=types) is not None:
        pass
    log.close()


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Find a recording; one that is to be made is made once."""
    folder = tmp_path_factory.mktemp("made")
    made = {"made.tlog": make_tlog, "made.bin": make_dataflash}
    return cache(lambda name: made[name](folder / name, MADE_MESSAGES) if name in made else Path(name))


@pytest.mark.parametrize("name", NAMES)
def test_read(benchmark: Any, found: Callable[[str], Path], name: str) -> None:
    file, _, reader = name.partition(": ")
    kind = next(kind for kind in READERS if file.startswith(kind))
    work = READERS[kind](found(FILES[file]))[reader]
    once = reader in (WHOLE, NEEDED)
    benchmark.pedantic(work, rounds=1 if once else RUNS, warmup_rounds=0 if once else 1)


def make_tlog(path: Path, messages: int) -> Path:
    """Make a flight: IMUs and attitude at every step, the rest at every fifth, 50 steps a second."""
    from pymavlink.dialects.v20 import ardupilotmega as m

    mav = m.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        for n in range(messages // STEP_MESSAGES):
            now, mag = 20 * n, (200 + n % 97, -50 - n % 89, -500 + n % 11)
            imu = (n % 50, -n % 50, -1000, n % 30, -n % 30, n % 700)
            step = [
                m.MAVLink_attitude_message(now, 0.1, -0.1, (n % 628) / 100 - 3.14, 0.0, 0.0, 0.1),
                m.MAVLink_raw_imu_message(now * 1000, *imu, *mag),
                m.MAVLink_scaled_imu2_message(now, *imu, *mag),
                m.MAVLink_scaled_imu3_message(now, *imu, *mag),
                m.MAVLink_ahrs2_message(0.1, 0.1, 1.0, 5.0, 1, 2),
                m.MAVLink_ekf_status_report_message(831, 0.1, 0.1, 0.1, 0.1, 0.0),
                m.MAVLink_vibration_message(now * 1000, 0.1, 0.2, 0.3, 0, 0, 0),
                m.MAVLink_sys_status_message(7, 7, 7, 300, 12000, 1500 + n % 500, 80, 0, 0, 0, 0, 0, 0),
                m.MAVLink_global_position_int_message(now, 479_000_000, 80_000_000, 500_000, 9, 1, 2, 3, 4),
                m.MAVLink_vfr_hud_message(1.0, 1.0, 90, 50, 500.0, 0.1),
                m.MAVLink_servo_output_raw_message(now, 0, 1500, 1600, 1700, 1800, 0, 0, 0, 0),
                m.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3),
            ]
            stamp = (1_700_000_000_000_000 + now * 1000).to_bytes(8, "big")
            file.write(b"".join(stamp + message.pack(mav) for message in step))
    return path


def make_dataflash(path: Path, records: int) -> Path:
    """Make a log of MAG, IMU, ATT and a few kinds that nobody needs."""
    sys.path.insert(0, str(PROJECT / "tests" / "logs"))
    from dataflash_builder import ATT, BAT, IMU, MAG, MSG, Log

    other = (30, "RATE", "Qffffff", "TimeUS,R,P,Y,A,B,C")
    log = Log(MAG, IMU, ATT, BAT, MSG, other).add("MSG", 0, "ArduRover V4.6.3")
    body, rates = (0.1, 0.2, 0.3, 0.1, 0.2, -9.8), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    for n in range(records // 8):
        now = n * 20_000
        for instance in (0, 1):
            log.add("MAG", now, instance, 200 + n % 97, -50, -500, 5, 13, -18)
            log.add("IMU", now, instance, *body).add("RATE", now + instance, *rates)
        log.add("ATT", now, 0, 10, 0, -10, 0.0, 90.0, 1.0).add("BAT", now, 0, 12.0, 15.0)
    return log.write(path)
