"""The clocks of a DataFlash log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.logs.boot_clock import BootClock, build_clock, impossible_times
from mavcompass.logs.dataflash_records import Log, Records

_MICRO, _MILLI = 1.0e-6, 1.0e-3
_GPS_EPOCH_UNIX_S = 315_964_800.0
_WEEK_S = 604_800.0
_LEAP_S = 18.0  # GPS minus UTC since 2017
# A clock of so many records is as good as one of all of them, and spares memory.
_ENOUGH = 1_000_000


def boot_time_s(name: str, records: Records) -> FloatArray | None:
    """Return seconds since boot of each record, (N,); None where this kind carries no time.

    TimeMS of an old GPS record is the time in the week; its time since boot is T.
    """
    if "TimeUS" in records:
        return records.decoded("TimeUS") * _MICRO
    if name == "GPS":
        return records.decoded("T") * _MILLI if "T" in records else None
    return records.decoded("TimeMS") * _MILLI if "TimeMS" in records else None


def leave_out_impossible_times(logs: Sequence[Log]) -> int:
    """Leave out records whose time leaps away from that of their neighbours of the same kind; count them."""
    left_out = 0
    for log in logs:
        for name, records in log.records.items():
            time_s = boot_time_s(name, records)
            if time_s is None:
                continue
            wrong = impossible_times(time_s)
            if wrong.size:
                left_out += wrong.size
                log.records[name] = records.select(np.delete(np.arange(len(records)), wrong))
    return left_out


def clock_of(logs: Sequence[Log]) -> BootClock:
    """Build the clock of a file from its logs, one power-up or more, with GPS time between them."""
    orders, boots, units = [], [], []
    for log in logs:
        offset_s = gps_unix_offset_s(log.records.get("GPS")) or 0.0
        for name, records in _enough(log):
            time_s = boot_time_s(name, records)
            if time_s is not None:
                orders.append(records.order)
                boots.append(time_s)
                units.append(time_s + offset_s)
    if not orders:
        return build_clock(np.zeros(1, np.uint32), np.zeros(1), np.zeros(1))
    return build_clock(np.concatenate(orders), np.concatenate(units), np.concatenate(boots))


def _enough(log: Log) -> list[tuple[str, Records]]:
    """Take as many kinds as make up a clock, always the densest."""
    out: list[tuple[str, Records]] = []
    for name, records in sorted(log.records.items(), key=lambda item: -len(item[1])):
        if out and sum(len(taken) for _, taken in out) + len(records) > _ENOUGH:
            break
        if len(records):
            out.append((name, records))
    return out


def gps_unix_offset_s(gps: Records | None) -> float | None:
    """Return Unix time minus time since boot by the GPS receiver's week; None where it had no time."""
    if gps is None:
        return None
    week, in_week = ("GWk", "GMS") if "GWk" in gps else ("Week", "TimeMS")
    time_s = boot_time_s("GPS", gps)
    if week not in gps or in_week not in gps or time_s is None:
        return None
    weeks, milliseconds = gps.decoded(week), gps.decoded(in_week)
    known = weeks > 0
    if not bool(known.any()):
        return None
    unix_s = _GPS_EPOCH_UNIX_S + weeks * _WEEK_S + milliseconds * _MILLI - _LEAP_S
    return float(np.median(unix_s[known] - time_s[known]))
