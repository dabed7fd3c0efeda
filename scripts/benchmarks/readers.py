"""Measure the readers of recordings beside pymavlink's and pyulog's, in one run on the same files.

    scripts/bench readers [-- --messages N --megabytes M --json FILE]

The telemetry log and the DataFlash log are made here, with the mix of messages that a vehicle sends;
recordings of the shared data are measured too where they are there. The best of three runs counts, for
every reader. Memory is that of a process which reads a file of `--megabytes` and nothing else.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
SHARED = PROJECT.parent / "shared" / "data"
sys.path.insert(0, str(PROJECT))
RUNS = 3
STEP_MESSAGES = 12  # of one step of the made telemetry log


QUICK = ("--messages", "60000")
WANTED_RATIO = {"telemetry log": 20.0, "DataFlash": 15.0}


def main(argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure every reader; return the figures of each file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=240_000, help="size of the made logs")
    parser.add_argument("--megabytes", type=int, default=0, help="also measure memory on logs of this size")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--read-and-report-memory", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.read_and_report_memory:
        report_memory(options.read_and_report_memory)
        return {}
    figures: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        made_tlog = make_tlog(Path(folder) / "made.tlog", options.messages)
        made_bin = make_dataflash(Path(folder) / "made.bin", options.messages)
        for path in (made_tlog, *SHARED.glob("real/*/flight.tlog"), *SHARED.glob("*/copter*.tlog")):
            figures.append(measure_tlog(path))
        for path in (made_bin, *SHARED.glob("*/copter*.BIN")):
            figures.append(measure_dataflash(path))
        figures += [measure_ulog(path) for path in SHARED.glob("real/*/*.ulg")]
        if options.megabytes:
            figures += measure_memory(made_tlog, options.megabytes)
            figures += measure_memory(made_bin, options.megabytes)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return {"files": figures, "checks": checks(figures)}


def checks(figures: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Put what is wanted beside what was measured: on the logs made here, and of memory."""
    out: list[dict[str, Any]] = []
    for figure in figures:
        if figure["what"] == "memory":
            what = f"peak MB for {figure['file_mb']:.0f} MB {figure['suffix']}"
            out.append({"what": what, "value": figure["peak_mb"], "at_most": figure["allowed_mb"]})
        elif figure["file"].startswith("made.") and figure["what"] in WANTED_RATIO:
            seconds = figure["seconds"]
            ours = seconds["mavcompass: Track of all needed columns"]
            theirs = next(taken for name, taken in seconds.items() if name.startswith("pymavlink"))
            what = f"{figure['what']}, times pymavlink's recv_match()"
            out.append({"what": what, "value": theirs / ours, "at_least": WANTED_RATIO[figure["what"]]})
    return out


def best_s(work: Callable[[], object], runs: int = RUNS) -> float:
    """Return the shortest of several runs, seconds."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def show(what: str, path: Path, messages: int, seconds: dict[str, float]) -> dict[str, Any]:
    """Print one file's figures, each reader beside ours."""
    ours = seconds["mavcompass: Track of all needed columns"]
    print(f"\n{what}: {path.name}, {messages} messages, {path.stat().st_size / 1e6:.1f} MB")
    for reader, taken in seconds.items():
        print(f"  {reader:48s} {taken:8.3f} s  {messages / taken / 1e3:9.0f} k/s  {taken / ours:7.1f} x")
    return {"what": what, "file": path.name, "messages": messages, "seconds": seconds}


def measure_tlog(path: Path) -> dict[str, Any]:
    from pymavlink import mavutil

    from mavcompass.logs.formats.tlog.messages import read_messages
    from mavcompass.logs.formats.tlog.reader import WANTED, read_tlog

    def theirs(types: list[str] | None) -> None:
        log = mavutil.mavlink_connection(str(path))
        while log.recv_match(type=types) is not None:
            pass
        log.close()

    read_tlog(path)
    seconds = {
        "pymavlink recv_match()": best_s(lambda: theirs(None), 1),
        "pymavlink recv_match(type=needed)": best_s(lambda: theirs(list(WANTED)), 1),
        "mavcompass: checked messages as columns": best_s(lambda: read_messages(path, WANTED)),
        "mavcompass: Track of all needed columns": best_s(lambda: read_tlog(path)),
    }
    return show("telemetry log", path, read_messages(path, {}).frames, seconds)


def measure_dataflash(path: Path) -> dict[str, Any]:
    from pymavlink import DFReader

    from mavcompass.logs.formats.dataflash.reader import WANTED, read_dataflash
    from mavcompass.logs.formats.dataflash.records import read_records

    def theirs(types: list[str] | None) -> None:
        log = DFReader.DFReader_binary(str(path))
        while log.recv_match(type=types) is not None:
            pass
        log.close()

    read_dataflash(path)
    seconds = {
        "pymavlink DFReader.recv_match()": best_s(lambda: theirs(None), 1),
        "pymavlink DFReader.recv_match(type=needed)": best_s(lambda: theirs(list(WANTED)), 1),
        "mavcompass: records as columns": best_s(lambda: read_records(path, WANTED)),
        "mavcompass: Track of all needed columns": best_s(lambda: read_dataflash(path)),
    }
    return show("DataFlash", path, sum(read_records(path, {}).counts.values()), seconds)


def measure_ulog(path: Path) -> dict[str, Any]:
    from pyulog import ULog

    from mavcompass.logs.formats.ulog.reader import read_ulog

    messages = sum(len(data.data["timestamp"]) for data in ULog(str(path)).data_list)
    seconds = {
        "pyulog ULog()": best_s(lambda: ULog(str(path))),
        "mavcompass: Track of all needed columns": best_s(lambda: read_ulog(path)),
    }
    return show("ULog", path, messages, seconds)


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


def measure_memory(made: Path, megabytes: int) -> list[dict[str, Any]]:
    """Repeat a made log's messages up to the size and read it in a process of its own."""
    content = made.read_bytes()
    start = max(content.rfind(b"\xa3\x95\x80") + 89, 0) if made.suffix == ".bin" else 0
    with tempfile.NamedTemporaryFile(suffix=made.suffix, dir=made.parent) as file:
        file.write(content[:start])
        for _ in range(max(1, megabytes * 1_000_000 // len(content))):
            file.write(content[start:])
        file.flush()
        command = [sys.executable, __file__, "--read-and-report-memory", file.name]
        figures: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        size_mb = Path(file.name).stat().st_size / 1e6
    allowed = 1.5 * figures["columns_mb"] + 100.0
    print(
        f"\nmemory, {size_mb:.0f} MB {made.suffix}: peak {figures['peak_mb']:.0f} MB, "
        f"columns {figures['columns_mb']:.0f} MB (1.5 x columns + 100 MB = {allowed:.0f} MB), "
        f"{figures['seconds']:.1f} s"
    )
    return [{"what": "memory", "file_mb": size_mb, "suffix": made.suffix, "allowed_mb": allowed, **figures}]


def report_memory(path: Path) -> None:
    """Read a recording; print the peak of resident memory and the size of the Track's columns."""
    from mavcompass.logs import read_track
    from mavcompass.track import Series

    start = time.process_time()
    track = read_track(path)
    taken = time.process_time() - start
    series = [getattr(track, name) for name in track.__slots__]
    series = [one for one in series if isinstance(one, Series)] + [
        c.reported for c in track.compasses.values()
    ]
    arrays = {id(array): array for one in series for array in (one.time_s, one.values)}
    columns_mb = sum(array.nbytes for array in arrays.values()) / 1e6
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    print(json.dumps({"peak_mb": peak_mb, "columns_mb": columns_mb, "seconds": taken}))


if __name__ == "__main__":
    main()
