"""The clocks of a DataFlash log."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.logs.dataflash_records import Records

_MICRO, _MILLI = 1.0e-6, 1.0e-3
_GPS_EPOCH_UNIX_S = 315_964_800.0
_WEEK_S = 604_800.0
_LEAP_S = 18.0  # GPS minus UTC since 2017


def boot_time_s(name: str, records: Records) -> FloatArray | None:
    """Return seconds since boot of each record, (N,); None where this kind carries no time.

    TimeMS of an old GPS record is the time in the week; its time since boot is T.
    """
    if "TimeUS" in records:
        return records.decoded("TimeUS") * _MICRO
    if name == "GPS":
        return records.decoded("T") * _MILLI if "T" in records else None
    return records.decoded("TimeMS") * _MILLI if "TimeMS" in records else None


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
