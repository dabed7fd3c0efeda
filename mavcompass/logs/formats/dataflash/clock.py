"""The clocks of a DataFlash log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.logs.common.boot_clock import BootClock, build_clock, impossible_times
from mavcompass.logs.formats.dataflash.records import Log, Records

_MICRO, _MILLI = 1.0e-6, 1.0e-3
_GPS_EPOCH_UNIX_S = 315_964_800.0
_WEEK_S = 604_800.0
_LEAP_S = 18.0  # GPS minus UTC since 2017
# A clock of so many records is as good as one of more, and spares memory.
_ENOUGH = 1_000_000


def boot_time_s(name: str, records: Records) -> FloatArray | None:
    """Return seconds since boot of each record, (N,); None where this kind carries no time.

    TimeMS of an old GPS record is the time in the week; its time since boot is T.
    """
    milliseconds = "T" if name == "GPS" else "TimeMS"
    for field, factor in (("TimeUS", _MICRO), (milliseconds, _MILLI)):
        if field in records:
            return np.asarray(records.rows[field] * factor, dtype=np.float64)
    return None


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
    densest = [_densest(log) for log in logs]
    stride = 1 + sum(len(found[1]) for found in densest if found is not None) // _ENOUGH
    orders, boots, units = [], [], []
    for log, found in zip(logs, densest, strict=True):
        if found is None:
            continue
        name, records = found
        time_s = boot_time_s(name, records)
        if time_s is None:
            continue
        order, time_s = records.order[::stride].copy(), time_s[::stride]
        order[0] = log.first_order  # what the log holds before belongs to it as well
        orders.append(order)
        boots.append(time_s)
        units.append(time_s + (gps_unix_offset_s(log.records.get("GPS")) or 0.0))
    if not orders:
        return build_clock(np.zeros(1, np.uint32), np.zeros(1), np.zeros(1))
    return build_clock(np.concatenate(orders), np.concatenate(units), np.concatenate(boots))


def _densest(log: Log) -> tuple[str, Records] | None:
    """Find the kind that comes most often: in one log every kind has the same clock."""
    timed = [
        (name, records)
        for name, records in log.records.items()
        if len(records) and boot_time_s(name, records.select(slice(0, 1))) is not None
    ]
    return max(timed, key=lambda found: len(found[1]), default=None)


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
