"""The columns of a Track, other than its compasses, from placed MAVLink messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mavcompass import telemetry
from mavcompass.frames import FloatArray, euler_to_quaternion, wrap_pi
from mavcompass.logs.motor_outputs import motor_outputs
from mavcompass.logs.tlog_compass import Samples
from mavcompass.track import Series
from mavcompass.units import RAD_PER_DEG

_CENTI = 0.01
_GPS_FIX_3D = 3
_UNKNOWN_U16 = 65535


def body_columns(body: Samples | None) -> dict[str, Series]:
    """Give accelerometer and gyro of the message that speaks for the first compass, on the same times."""
    if body is None:
        return {}
    rows: Any = body.rows
    if body.name == "HIGHRES_IMU":
        acc = np.stack([rows.xacc, rows.yacc, rows.zacc]).T
        gyro = np.stack([rows.xgyro, rows.ygyro, rows.zgyro]).T
    else:
        acc, gyro = telemetry.acceleration_mps2(rows), telemetry.angular_rate_radps(rows)
    return {"acc_mps2": Series.of(body.time_s, acc), "gyro_radps": Series.of(body.time_s, gyro)}


def columns(samples: dict[str, Samples], parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every other column that the messages give; `samples` is emptied on the way, to spare memory."""
    out = _temperature(samples) | _gps(samples) | _current(samples)
    for name, column, read in _SIMPLE:
        found = samples.pop(name, None)
        if found is not None:
            out[column] = Series.of(found.time_s, read(found.rows))
    servo = samples.pop("SERVO_OUTPUT_RAW", None)
    if servo is not None:
        rows: Any = servo.rows
        main = rows.port == 0
        outputs = np.stack([rows[f"servo{n}_raw"][main] for n in range(1, 9)]).T
        motors = motor_outputs(outputs, parameters)
        if motors is not None:
            out["motors"] = Series.of(servo.time_s[main], motors)
    return out


def _velocity(rows: Any) -> FloatArray:
    return np.stack([rows.vx, rows.vy, rows.vz]).T * _CENTI


_SIMPLE: tuple[tuple[str, str, Callable[[Any], FloatArray]], ...] = (
    ("ATTITUDE", "attitude_rad", telemetry.euler_rad),
    ("SIMSTATE", "truth_q", lambda rows: euler_to_quaternion(*telemetry.euler_rad(rows).T)),
    ("LOCAL_POSITION_NED", "position_ned_m", lambda rows: np.stack([rows.x, rows.y, rows.z]).T),
    ("VFR_HUD", "throttle", lambda rows: np.clip(rows.throttle * _CENTI, 0.0, 1.0)),
)


def _gps(samples: dict[str, Samples]) -> dict[str, Series]:
    """Read place, velocity and yaw; place and velocity from the filter where it reports them."""
    out: dict[str, Series] = {}
    receiver = samples.pop("GPS_RAW_INT", None)
    if receiver is not None:
        rows: Any = receiver.rows
        has_yaw = (rows.yaw > 0) & (rows.yaw != _UNKNOWN_U16)
        if bool(has_yaw.any()):
            yaw = wrap_pi(rows.yaw[has_yaw] * (_CENTI * RAD_PER_DEG))
            out["gps_yaw_rad"] = Series.of(receiver.time_s[has_yaw], yaw)
        fix = rows.fix_type >= _GPS_FIX_3D
        if bool(fix.any()):
            out["place"] = Series.of(receiver.time_s[fix], telemetry.place(rows[fix]))
        moves = fix & (rows.vel != _UNKNOWN_U16) & (rows.cog != _UNKNOWN_U16)
        if bool(moves.any()):
            out["gps_velocity_mps"] = Series.of(receiver.time_s[moves], _ground_velocity(rows[moves]))
    estimate = samples.pop("GLOBAL_POSITION_INT", None)
    if estimate is not None:
        rows = estimate.rows
        placed = (rows.lat != 0) | (rows.lon != 0)
        if bool(placed.any()):
            time_s = estimate.time_s if bool(placed.all()) else estimate.time_s[placed]
            rows = rows if bool(placed.all()) else rows[placed]
            out["place"] = Series.of(time_s, telemetry.place(rows))
            out["gps_velocity_mps"] = Series.of(time_s, _velocity(rows))
    return out


def _ground_velocity(rows: Any) -> FloatArray:
    """Turn speed and course over ground into north, east and an unknown down."""
    speed, course = rows.vel * _CENTI, rows.cog * (_CENTI * RAD_PER_DEG)
    return np.stack([speed * np.cos(course), speed * np.sin(course), np.full(speed.size, np.nan)]).T


def _current(samples: dict[str, Samples]) -> dict[str, Series]:
    """Read the first battery's current from SYS_STATUS or BATTERY_STATUS, whichever has more of it."""
    best: Series | None = None
    for name in ("SYS_STATUS", "BATTERY_STATUS"):
        found = samples.pop(name, None)
        if found is None:
            continue
        rows: Any = found.rows
        measured = rows.current_battery >= 0
        if name == "BATTERY_STATUS":
            measured &= rows.id == 0
        if np.count_nonzero(measured) > (0 if best is None else len(best)):
            current = telemetry.battery_current_a(rows[measured])
            best = Series.of(found.time_s[measured], current)
    return {} if best is None else {"current_a": best}


def _temperature(samples: dict[str, Samples]) -> dict[str, Series]:
    """Read the IMU's temperature, or else the barometer's; zero stands for not measured."""
    for name in (*telemetry.MAG_MESSAGES, "SCALED_PRESSURE"):
        found = samples.get(name)
        rows: Any = None if found is None else found.rows
        if found is not None and bool(rows.temperature.any()):
            return {"temperature_degc": Series.of(found.time_s, rows.temperature * _CENTI)}
    return {}
