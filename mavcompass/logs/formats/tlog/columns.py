"""The columns of a Track from placed MAVLink messages, and which of these speak for which compass."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mavcompass.compass_parameters import ardupilot_name, px4_name, px4_sensor_to_body
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.credible import open_ended, quaternions_of, turned_field
from mavcompass.frames import FloatArray
from mavcompass.logs.common.parameter_steps import Change, ardupilot_steps, px4_steps
from mavcompass.logs.common.samples import finite_series, motor_outputs, spoken
from mavcompass.logs.formats.tlog.clock import Placer, Samples
from mavcompass.messages import telemetry
from mavcompass.track import InForce, MagSeries, Series
from mavcompass.units import MGAUSS_PER_GAUSS, MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

HIGHRES = "HIGHRES_IMU"
# ArduPilot sent HIGHRES_IMU's field a million times too large until 2026; Earth's is below one gauss.
_NO_FIELD_GAUSS = 1000.0
_ARDUPILOT_HIGHRES_PER_MGAUSS = 1000.0
_DENSER, _DENSER_PX4 = 2, 10
_LESS_LEARNT = (
    "PX4's HIGHRES_IMU is less the bias that its estimator learns in flight, which it does not tell: iron may"
    " be hidden by it. Record SCALED_IMU too, with the parameters, or give the autopilot's own log (.ulg)."
)


def spokesmen(count: Callable[[str], int], autopilot: str, rotation_known: bool) -> dict[int, str]:
    """Choose the message for each compass, by instance; `count` tells how many messages of a name there are.

    Compass 1 speaks in up to three messages. Of RAW_IMU and SCALED_IMU the denser is taken. HIGHRES_IMU
    steps in where it is more than twice as dense. On PX4 it holds what the estimator leaves of the iron:
    there it steps in only where SCALED_IMU is too seldom to follow a turn, or its axes are not known.
    """
    chosen: dict[int, str] = {}
    for name, instance in telemetry.MAG_MESSAGES.items():
        if count(name) > (count(chosen[instance]) if instance in chosen else 0):
            chosen[instance] = name
    blind = autopilot == "px4" and not rotation_known
    times = _DENSER_PX4 if autopilot == "px4" else _DENSER
    if count(HIGHRES) and (1 not in chosen or blind or count(HIGHRES) > times * count(chosen[1])):
        chosen[1] = HIGHRES
    return dict(sorted(chosen.items()))


def compass_of(
    instance: int,
    samples: Samples,
    autopilot: str,
    history: Sequence[Change],
    parameters: Mapping[str, float],
) -> tuple[MagSeries | None, tuple[str, ...]]:
    """Build one compass's readings with the corrections inside them, and notes on what was supposed.

    None where the message carries no magnetic field.
    """
    notes: list[str] = []
    highres = samples.name == HIGHRES
    rows = samples.rows
    reported = _highres_mgauss(rows, autopilot) if highres else open_ended(telemetry.field_mgauss(rows))
    steps: tuple[InForce, ...] = (InForce(-np.inf, IDENTITY),)
    known = True
    device_id: float | None = None
    not_applied: FieldCorrection | None = None
    if autopilot == "ardupilot":
        steps, known = ardupilot_steps(history, instance)
        device_id = parameters.get(ardupilot_name("DEV_ID", instance))
    elif autopilot == "px4":
        device_id = parameters.get(px4_name("ID", instance))
        in_force, in_force_known = px4_steps(history, instance)
        if highres:
            steps, known = in_force, in_force_known
            notes.append(_LESS_LEARNT)
        else:
            not_applied = in_force[-1].correction if in_force_known else None
            reported, more = _px4_body_axes(reported, parameters, instance)
            notes += more
    else:
        known = False
    series, silences = spoken(finite_series(samples.time_s, reported), instance)
    if series is None:
        return None, (f"{samples.name} carries no magnetic field: there is no compass {instance}.",)
    notes += silences
    compass = MagSeries(
        instance=instance,
        reported=series,
        in_force=steps,
        correction_known=known,
        quantum_mgauss=0.0 if highres else 1.0,
        truncated=not highres,
        device_id=None if device_id is None else int(device_id),
        not_applied=not_applied,
        less_learnt=highres and autopilot == "px4",
    )
    return compass, tuple(notes)


def _px4_body_axes(
    sensor_mgauss: FloatArray, parameters: Mapping[str, float], instance: int
) -> tuple[FloatArray, tuple[str, ...]]:
    """Turn PX4's SCALED_IMU, uncorrected and in the sensor's axes, into body axes."""
    name = px4_name("ROT", instance)
    if name not in parameters:
        return sensor_mgauss, (f"{name} is not recorded: compass {instance} is taken as not rotated.",)
    return turned_field(sensor_mgauss, px4_sensor_to_body(parameters, instance)), ()


def _highres_mgauss(rows: object, autopilot: str) -> FloatArray:
    field = telemetry.field_mgauss(rows).astype(np.float64)
    if autopilot == "ardupilot" and float(np.median(np.abs(field).max(axis=1))) > _NO_FIELD_GAUSS:
        return field / _ARDUPILOT_HIGHRES_PER_MGAUSS
    return field * MGAUSS_PER_GAUSS


_CENTI = 0.01
# SYS_STATUS's voltage where it is not told.
_NO_VOLTAGE = 65535


def body_columns(body: Samples) -> dict[str, Series]:
    """Give accelerometer, gyro and temperature of one message, on the same times as its field."""
    rows: Any = body.rows
    acc = np.stack([rows.xacc, rows.yacc, rows.zacc]).T
    gyro = np.stack([rows.xgyro, rows.ygyro, rows.zgyro]).T
    if body.name == HIGHRES:
        degc = rows.temperature.astype(np.float64)
    else:
        acc, gyro = open_ended(acc) * MPS2_PER_MILLI_G, open_ended(gyro) * RADPS_PER_MILLIRADPS
        degc = rows.temperature * _CENTI
    out = {"acc_mps2": finite_series(body.time_s, acc), "gyro_radps": finite_series(body.time_s, gyro)}
    if bool(degc.any()):  # zero stands for not measured
        out["temperature_degc"] = finite_series(body.time_s, degc)
    return _present(out)


def _present(columns: Mapping[str, Series | None]) -> dict[str, Series]:
    return {name: series for name, series in columns.items() if series is not None}


def columns(placer: Placer, parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every column of the vehicle as a whole that the messages give."""
    out: dict[str, Series | None] = {**_gps(placer), **_battery(placer)}
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
    return open_ended(np.stack([rows.vx, rows.vy, rows.vz]).T) * _CENTI


_SIMPLE: tuple[tuple[str, str, Callable[[Any], FloatArray]], ...] = (
    ("ATTITUDE", "attitude_rad", telemetry.euler_rad),
    ("SIMSTATE", "truth_q", lambda rows: quaternions_of(telemetry.euler_rad(rows))),
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
        fix = rows.fix_type >= telemetry.FIX_3D
        if bool(fix.any()):
            out["place"] = Series.of(receiver.time_s[fix], telemetry.place(rows[fix]))
        velocity = telemetry.ground_velocity_mps(rows)
        if bool((moves := np.isfinite(velocity[:, 0])).any()):
            out["gps_velocity_mps"] = Series.of(receiver.time_s[moves], velocity[moves])
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


def _battery(placer: Placer) -> dict[str, Series]:
    """Read the first battery's voltage; its current from whichever of two messages has more of it."""
    out: dict[str, Series] = {}
    best: Series | None = None
    for name in ("SYS_STATUS", "BATTERY_STATUS"):
        found = placer.take(name)
        if found is None:
            continue
        rows: Any = found.rows
        measured = rows.current_battery >= 0
        if name == "SYS_STATUS" and bool((told := rows.voltage_battery != _NO_VOLTAGE).any()):
            out["voltage_v"] = Series.of(found.time_s[told], rows.voltage_battery[told] * 1e-3)
        if name == "BATTERY_STATUS":
            measured &= rows.id == 0
        if np.count_nonzero(measured) > (0 if best is None else len(best)):
            current = open_ended(rows.current_battery[measured]) * _CENTI
            best = Series.of(found.time_s[measured], current)
    return out if best is None else out | {"current_a": best}
