"""The columns of a Track, other than its compasses, from DataFlash records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mavcompass.frames import FloatArray, euler_to_quaternion, wrap_pi
from mavcompass.logs.boot_clock import BootClock
from mavcompass.logs.dataflash_records import Log, Records
from mavcompass.logs.dataflash_time import boot_time_s
from mavcompass.logs.motor_outputs import motor_outputs
from mavcompass.track import Series
from mavcompass.units import RAD_PER_DEG

_GPS_FIX_3D = 3
_INSTANCE = ("I", "Inst", "Instance", "C")


def columns(logs: Sequence[Log], clock: BootClock, parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every column that the logs give; their records are taken out on the way, to spare memory."""
    reader = _Reader(logs, clock)
    gps = reader.gps()
    out = {
        **reader.imu(),
        "attitude_rad": reader.attitude(),
        "truth_q": reader.truth(),
        "gps_yaw_rad": gps.get("yaw"),
        "gps_velocity_mps": gps.get("velocity"),
        "position_ned_m": reader.vector("XKF1", "PN", "PE", "PD") or reader.vector("NKF1", "PN", "PE", "PD"),
        "place": reader.vector("POS", "Lat", "Lng", "Alt") or gps.get("place"),
        "current_a": reader.current(),
        "throttle": reader.throttle(),
        "motors": reader.motors(parameters),
    }
    if out.get("temperature_degc") is None:
        out["temperature_degc"] = reader.vector("BARO", "Temp")
    return {name: series for name, series in out.items() if series is not None}


class _Reader:
    """Read quantities across the logs of one file."""

    def __init__(self, logs: Sequence[Log], clock: BootClock) -> None:
        self._logs = logs
        self._clock = clock

    def _parts(self, name: str, *fields: str) -> list[tuple[FloatArray, Records]]:
        """Return times and records of one kind, first instance only, from logs that have all `fields`."""
        out = []
        for log in self._logs:
            records = log.records.get(name)
            if records is None or any(field not in records for field in fields):
                continue
            for field in _INSTANCE:
                if field in records:
                    records = records.select(records.rows[field] == 0)
                    break
            boot_s = boot_time_s(name, records)
            if boot_s is not None and len(records):
                out.append((self._clock.from_boot(records.order, boot_s), records))
        return out

    def _series(self, parts: Sequence[tuple[FloatArray, FloatArray]]) -> Series | None:
        if not parts:
            return None
        time_s = np.concatenate([time for time, _ in parts])
        values = np.concatenate([value for _, value in parts])
        if not time_s.size:
            return None
        if bool((np.diff(time_s) < 0.0).any()):
            order = np.argsort(time_s, kind="stable")
            time_s, values = time_s[order], values[order]
        return Series.of(time_s, values)

    def vector(self, name: str, *fields: str, otherwise: float = 1.0) -> Series | None:
        """Read one field as (N,), or several as (N, k)."""
        parts = []
        for time_s, records in self._parts(name, *fields):
            values = [records.quantity(field, otherwise) for field in fields]
            parts.append((time_s, values[0] if len(fields) == 1 else np.stack(values).T))
        return self._series(parts)

    def imu(self) -> dict[str, Series | None]:
        """Read accelerometer, gyro and temperature of the first IMU, on the same times."""
        acc = self.vector("IMU", "AccX", "AccY", "AccZ")
        gyro = self.vector("IMU", "GyrX", "GyrY", "GyrZ")
        if acc is not None and gyro is not None and len(acc) == len(gyro):
            gyro = Series(acc.time_s, gyro.values)
        temperature = self.vector("IMU", "T") or self.vector("IMU", "Temp")
        if temperature is not None and not bool(temperature.values.any()):
            temperature = None
        return {"acc_mps2": acc, "gyro_radps": gyro, "temperature_degc": temperature}

    def attitude(self) -> Series | None:
        """Read roll, pitch, yaw; the log's yaw runs from 0 to 360."""
        found = self.vector("ATT", "Roll", "Pitch", "Yaw", otherwise=RAD_PER_DEG)
        if found is not None:
            found.values[:, 2] = wrap_pi(found.values[:, 2])
        return found

    def truth(self) -> Series | None:
        """Read a simulator's true attitude."""
        found = self.vector("SIM", "Q1", "Q2", "Q3", "Q4")
        if found is not None and bool(found.values.any()):
            return found
        angles = self.vector("SIM", "Roll", "Pitch", "Yaw", otherwise=RAD_PER_DEG)
        return None if angles is None else Series.of(angles.time_s, euler_to_quaternion(*angles.values.T))

    def gps(self) -> dict[str, Series | None]:
        """Read place, velocity and yaw of the first receiver, where it has a fix in three dimensions."""
        place, velocity, yaw = [], [], []
        for time_s, records in self._parts("GPS", "Status", "Lat", "Lng", "Alt"):
            fix = records.rows["Status"] >= _GPS_FIX_3D
            fixed, when = records.select(fix), time_s[fix]
            place.append((when, np.stack([fixed.quantity(field) for field in ("Lat", "Lng", "Alt")]).T))
            if "Spd" in records and "GCrs" in records:
                velocity.append((when, _ground_velocity(fixed)))
            if "Yaw" in records:
                heading = fixed.quantity("Yaw", RAD_PER_DEG)
                known = heading != 0.0  # exactly zero stands for none
                yaw.append((when[known], wrap_pi(heading[known])))
        return {"place": self._series(place), "velocity": self._series(velocity), "yaw": self._series(yaw)}

    def current(self) -> Series | None:
        """Read the first battery's current; old logs keep it as hundredths of an ampere in whole numbers."""
        parts = []
        for name in ("BAT", "CURR"):
            for time_s, records in self._parts(name, "Curr"):
                old = records.fields["Curr"].character in "hH"
                parts.append((time_s, records.quantity("Curr", 0.01 if old else 1.0)))
        return self._series(parts)

    def throttle(self) -> Series | None:
        """Read the throttle output as a fraction, whatever the firmware's scale: 1, 100 or 1000 is full."""
        found = self.vector("CTUN", "ThO") or self.vector("CTUN", "ThrOut") or self.vector("THR", "ThrOut")
        if found is None:
            return None
        size = np.abs(found.values)
        largest = float(np.nanmax(size)) if bool(np.isfinite(size).any()) else 0.0
        full = 1.0 if largest <= 1.5 else 100.0 if largest <= 150.0 else 1000.0
        return Series.of(found.time_s, np.clip(size / full, 0.0, 1.0))

    def motors(self, parameters: Mapping[str, float]) -> Series | None:
        """Read the motors' outputs as fractions."""
        for stem in ("C", "Ch", "Chan"):
            pulses = self.vector("RCOU", *(f"{stem}{n}" for n in range(1, 9)))
            if pulses is not None:
                motors = motor_outputs(pulses.values, parameters)
                return None if motors is None else Series.of(pulses.time_s, motors)
        return None


def _ground_velocity(records: Records) -> FloatArray:
    speed, course = records.quantity("Spd"), records.quantity("GCrs", RAD_PER_DEG)
    down = records.quantity("VZ") if "VZ" in records else np.full(len(records), np.nan)
    return np.stack([speed * np.cos(course), speed * np.sin(course), down]).T
