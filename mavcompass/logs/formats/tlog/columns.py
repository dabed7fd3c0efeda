"""The columns of a Track, other than its compasses, from placed MAVLink messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mavcompass.frames import FloatArray, euler_to_quaternion
from mavcompass.logs.common import finite_series, motor_outputs
from mavcompass.logs.formats.tlog.clock import Placer, Samples
from mavcompass.logs.formats.tlog.compasses import HIGHRES
from mavcompass.messages import telemetry
from mavcompass.track import Series

_CENTI = 0.01
_GPS_FIX_3D = 3
_UNKNOWN_U16 = 65535


def body_columns(body: Samples) -> dict[str, Series]:
    """Give accelerometer, gyro and temperature of one message, on the same times as its field."""
    rows: Any = body.rows
    if body.name == HIGHRES:
        acc = np.stack([rows.xacc, rows.yacc, rows.zacc]).T
        gyro = np.stack([rows.xgyro, rows.ygyro, rows.zgyro]).T
        degc = rows.temperature.astype(np.float64)
    else:
        acc, gyro = telemetry.acceleration_mps2(rows), telemetry.angular_rate_radps(rows)
        degc = rows.temperature * _CENTI
    out = {"acc_mps2": finite_series(body.time_s, acc), "gyro_radps": finite_series(body.time_s, gyro)}
    if bool(degc.any()):  # zero stands for not measured
        out["temperature_degc"] = finite_series(body.time_s, degc)
    return _present(out)


def _present(columns: Mapping[str, Series | None]) -> dict[str, Series]:
    return {name: series for name, series in columns.items() if series is not None}


def columns(placer: Placer, parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every column of the vehicle as a whole that the messages give."""
    out: dict[str, Series | None] = {**_gps(placer), **_current(placer)}
    for name, column, read in _SIMPLE:
        found = placer.take(name)
        if found is not None:
            out[column] = finite_series(found.time_s, read(found.rows))
    servo = placer.take("SERVO_OUTPUT_RAW")
    if servo is not None:
        main = servo.rows.port == 0
        outputs = np.stack([servo.rows[f"servo{n}_raw"][main] for n in range(1, 9)]).T
        motors = motor_outputs(outputs, parameters)
        if motors is not None:
            out["motors"] = Series.of(servo.time_s[main], motors)
    return _present(out)


def _velocity(rows: Any) -> FloatArray:
    return np.stack([rows.vx, rows.vy, rows.vz]).T * _CENTI


_SIMPLE: tuple[tuple[str, str, Callable[[Any], FloatArray]], ...] = (
    ("ATTITUDE", "attitude_rad", telemetry.euler_rad),
    ("SIMSTATE", "truth_q", lambda rows: euler_to_quaternion(*telemetry.euler_rad(rows).T)),
    ("LOCAL_POSITION_NED", "position_ned_m", lambda rows: np.stack([rows.x, rows.y, rows.z]).T),
    ("VFR_HUD", "throttle", lambda rows: np.clip(rows.throttle * _CENTI, 0.0, 1.0)),
    ("SCALED_PRESSURE", "temperature_degc", lambda rows: rows.temperature * _CENTI),
)


def _gps(placer: Placer) -> dict[str, Series]:
    """Read place, velocity and yaw; place and velocity from the filter where it reports them."""
    out: dict[str, Series] = {}
    receiver = placer.take("GPS_RAW_INT")
    if receiver is not None:
        rows: Any = receiver.rows
        yaw = telemetry.second_antenna_rad(rows)
        if bool((has_yaw := np.isfinite(yaw)).any()):
            out["gps_yaw_rad"] = Series.of(receiver.time_s[has_yaw], yaw[has_yaw])
        fix = rows.fix_type >= _GPS_FIX_3D
        if bool(fix.any()):
            out["place"] = Series.of(receiver.time_s[fix], telemetry.place(rows[fix]))
        moves = fix & (rows.vel != _UNKNOWN_U16) & (rows.cog != _UNKNOWN_U16)
        if bool(moves.any()):
            out["gps_velocity_mps"] = Series.of(
                receiver.time_s[moves], telemetry.ground_velocity_mps(rows[moves])
            )
    estimate = placer.take("GLOBAL_POSITION_INT")
    if estimate is not None:
        rows = estimate.rows
        placed = (rows.lat != 0) | (rows.lon != 0)
        if bool(placed.any()):
            time_s = estimate.time_s if bool(placed.all()) else estimate.time_s[placed]
            rows = rows if bool(placed.all()) else rows[placed]
            out["place"] = Series.of(time_s, telemetry.place(rows))
            if "gps_velocity_mps" in out:
                out["receiver_velocity_mps"] = out["gps_velocity_mps"]
            out["gps_velocity_mps"] = Series.of(time_s, _velocity(rows))
    return out


def _current(placer: Placer) -> dict[str, Series]:
    """Read the first battery's current from SYS_STATUS or BATTERY_STATUS, whichever has more of it."""
    best: Series | None = None
    for name in ("SYS_STATUS", "BATTERY_STATUS"):
        found = placer.take(name)
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
