"""The columns of a Track from DataFlash records, and the clocks of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.credible import converted, incredible, quaternions_of
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.logs.common.boot_clock import BootClock, build_clock, impossible_times
from mavcompass.logs.common.samples import finite_series, motor_outputs
from mavcompass.logs.formats.dataflash.records import Log, Records
from mavcompass.track import Series
from mavcompass.units import RAD_PER_DEG

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


_GPS_FIX_3D = 3
_INSTANCE = ("I", "Inst", "Instance", "C")
_CENTI = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Hold one kind of records (one instance) from all logs of a file.

    Attributes:
        time_s: (N,).
        parts: the records, one part for each log.
    """

    time_s: FloatArray
    parts: tuple[Records, ...]

    def __contains__(self, field: object) -> bool:
        """Tell whether every log has this field."""
        return all(field in records for records in self.parts)

    def values(self, *fields: str, otherwise: float = 1.0) -> FloatArray:
        """Return one field as (N,), or several as (N, k), contiguous columns, in the units used inside."""
        out = np.empty((self.time_s.size, len(fields)), order="F")
        for column, field in enumerate(fields):
            first = 0
            for records in self.parts:
                values = records.quantity(field, otherwise)
                out[first : first + values.size, column] = values
                first += values.size
        return out[:, 0] if len(fields) == 1 else out

    def series(self, *fields: str, otherwise: float = 1.0) -> Series | None:
        """Return fields as a series; None where a log lacks one, or nothing is a number."""
        if any(field not in self for field in fields):
            return None
        return finite_series(self.time_s, self.values(*fields, otherwise=otherwise))

    def whole_numbers(self, field: str) -> bool:
        """Tell whether the log keeps a field as whole numbers."""
        return all(records.fields[field].character not in "fdg" for records in self.parts)


def take(
    logs: Sequence[Log], clock: BootClock, name: str, only: int | None = None
) -> Iterator[tuple[int, Placed]]:
    """Take one kind of records out of the logs; yield each instance (0 where the kind has none).

    With `only`, the other instances are dropped. What was yielded is not kept, to spare memory.
    """
    found: dict[int, list[Records]] = {}
    for log in logs:
        records = log.records.pop(name, None)
        if records is None or not len(records) or boot_time_s(name, records.select(slice(0, 1))) is None:
            continue
        field = next((field for field in _INSTANCE if field in records), None)
        numbers = None if field is None else records.rows[field]
        if numbers is None or not numbers.any():
            found.setdefault(0, []).append(records)
            continue
        for number in np.unique(numbers).tolist():
            if only is None or number == only:
                found.setdefault(int(number), []).append(records.select(numbers == number))
    records = numbers = None
    for number in sorted(found):
        yield number, _place(name, found.pop(number), clock)


def _place(name: str, parts: list[Records], clock: BootClock) -> Placed:
    pieces = []
    for records in parts:
        boot_s = boot_time_s(name, records)
        assert boot_s is not None  # only kinds with a time come here
        pieces.append(clock.from_boot(records.order, boot_s))
    return Placed(pieces[0] if len(pieces) == 1 else np.concatenate(pieces), tuple(parts))


def _series(placed: Placed | None, *fields: str, otherwise: float = 1.0) -> Series | None:
    return None if placed is None else placed.series(*fields, otherwise=otherwise)


def columns(logs: Sequence[Log], clock: BootClock, parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every column other than the compasses; the records are taken out of the logs on the way."""

    def first(name: str) -> Placed | None:
        return next((placed for _, placed in take(logs, clock, name, only=0)), None)

    estimate = first("XKF1") or first("NKF1")
    place = first("POS")
    out: dict[str, Series | None] = {"place": None, **_gps(first("GPS"))}
    out["place"] = _series(place, "Lat", "Lng", "Alt") or out["place"]
    out["position_ned_m"] = _series(estimate, "PN", "PE", "PD")
    baro = first("BARO")
    out["temperature_degc"] = _series(baro, "Temp")
    out |= {name: series for name, series in _imu(first("IMU")).items() if series is not None}
    out["attitude_rad"] = _attitude(first("ATT"))
    out["truth_q"] = _truth(first("SIM"))
    battery = first("BAT") or first("CURR")
    out["current_a"], out["voltage_v"] = _of_battery(battery, "Curr"), _of_battery(battery, "Volt")
    out["throttle"] = _throttle(first("CTUN"), first("THR"))
    out["motors"] = _motors(first("RCOU"), parameters)
    return {name: series for name, series in out.items() if series is not None and len(series)}


def _imu(imu: Placed | None) -> dict[str, Series | None]:
    """Read accelerometer, gyro and temperature of the first IMU, on the same times."""
    if imu is None:
        return {}
    temperature = imu.series("T") or imu.series("Temp")
    if temperature is not None and not bool(temperature.values.any()):
        temperature = None  # zero stands for not measured
    return {
        "acc_mps2": imu.series("AccX", "AccY", "AccZ"),
        "gyro_radps": imu.series("GyrX", "GyrY", "GyrZ"),
        "temperature_degc": temperature,
    }


def _attitude(attitude: Placed | None) -> Series | None:
    """Read roll, pitch, yaw; the log's yaw runs from 0 to 360 degrees."""
    found = _series(attitude, "Roll", "Pitch", "Yaw", otherwise=RAD_PER_DEG)
    if found is not None:
        found.values[:, 2] = converted("gps_yaw_rad", found.values[:, 2], wrap_pi)
    return found


def _truth(sim: Placed | None) -> Series | None:
    """Read a simulator's true attitude."""
    if sim is None:
        return None
    found = sim.series("Q1", "Q2", "Q3", "Q4")
    if found is not None and bool(found.values.any()):
        return found
    angles = sim.series("Roll", "Pitch", "Yaw", otherwise=RAD_PER_DEG)
    return None if angles is None else Series.of(angles.time_s, quaternions_of(angles.values))


def _gps(gps: Placed | None) -> dict[str, Series | None]:
    """Read place, velocity and yaw of the first receiver, where it has a fix in three dimensions."""
    if gps is None or "Status" not in gps:
        return {}
    fix = gps.values("Status") >= _GPS_FIX_3D
    time_s = gps.time_s[fix]
    out: dict[str, Series | None] = {}
    if all(field in gps for field in ("Lat", "Lng", "Alt")):
        out["place"] = finite_series(time_s, gps.values("Lat", "Lng", "Alt")[fix])
    if "Spd" in gps and "GCrs" in gps:
        speed, course = gps.values("Spd")[fix], gps.values("GCrs", otherwise=RAD_PER_DEG)[fix]
        down = gps.values("VZ")[fix] if "VZ" in gps else np.full(speed.size, np.nan)
        there = converted("gps_yaw_rad", course, lambda rad: np.stack([np.cos(rad), np.sin(rad)]).T)
        velocity = np.column_stack([speed[:, np.newaxis] * there, down])
        out["gps_velocity_mps"] = Series.of(time_s, velocity)
    if "Yaw" in gps:
        yaw = gps.values("Yaw", otherwise=RAD_PER_DEG)[fix]
        known = yaw != 0.0  # exactly zero stands for none
        out["gps_yaw_rad"] = finite_series(time_s[known], converted("gps_yaw_rad", yaw[known], wrap_pi))
    return out


def _of_battery(battery: Placed | None, name: str) -> Series | None:
    """Read the first battery's current or voltage; old logs keep it as hundredths in whole numbers."""
    if battery is None or name not in battery:
        return None
    return battery.series(name, otherwise=_CENTI if battery.whole_numbers(name) else 1.0)


def _throttle(control: Placed | None, rover: Placed | None) -> Series | None:
    """Read the throttle output as a fraction, whatever the firmware's scale: 1, 100 or 1000 is full."""
    found = _series(control, "ThO") or _series(control, "ThrOut") or _series(rover, "ThrOut")
    if found is None:
        return None
    size = np.abs(found.values)
    largest = float(size[~incredible("throttle", size)].max(initial=0.0))
    full = 1.0 if largest <= 1.5 else 100.0 if largest <= 150.0 else 1000.0
    return Series.of(found.time_s, converted("throttle", size, lambda s: np.clip(s / full, 0.0, 1.0)))


def _motors(outputs: Placed | None, parameters: Mapping[str, float]) -> Series | None:
    """Read the motors' outputs as fractions."""
    for stem in ("C", "Ch", "Chan"):
        names = tuple(f"{stem}{n}" for n in range(1, 9))
        if outputs is not None and all(name in outputs for name in names):
            motors = motor_outputs(outputs.values(*names), parameters)
            return None if motors is None else Series.of(outputs.time_s, motors)
    return None
