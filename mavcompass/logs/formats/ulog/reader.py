"""Read PX4's own log (ULog, .ulg) into a Track: its columns from the topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.credible import angles_of, converted, incredible
from mavcompass.errors import NoMagnetometer
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.kinds import VEHICLES
from mavcompass.logs.common.chunks import damage
from mavcompass.logs.common.parameter_steps import changes
from mavcompass.logs.common.samples import finite_series, motor_outputs, texts_said
from mavcompass.logs.formats.ulog.compasses import MAG_TOPICS, compasses
from mavcompass.logs.formats.ulog.messages import Topic, ULogContents, indexed, read_messages
from mavcompass.track import Series, Track

_TOPICS = (
    "vehicle_status",
    "vehicle_attitude",
    "vehicle_attitude_groundtruth",
    "vehicle_local_position",
    "vehicle_global_position",
    "vehicle_gps_position",
    "sensor_gps",
    "sensor_accel",
    "sensor_gyro",
    "sensor_baro",
    "battery_status",
    "vehicle_thrust_setpoint",
    "actuator_controls_0",
    "actuator_motors",
    "actuator_outputs",
)
Topics = Mapping[str, Sequence[Topic]]

_ACCELEROMETERS = (("sensor_combined", *indexed("accelerometer_m_s2")), ("sensor_accel", "x", "y", "z"))
_GYROS = (("sensor_combined", *indexed("gyro_rad")), ("sensor_gyro", "x", "y", "z"))
_VEHICLE_TYPES = {1: "copter", 2: "plane", 3: "rover"}
_GPS_FIX_3D = 3
_MICRO, _MILLI = 1.0e-6, 1.0e-3
_DEG_PER_E7 = 1.0e-7
# Output values above this are pulse widths, below it fractions.
_FRACTION = 10.0


def read_ulog(path: Path) -> Track:
    """Read a ULog. Raises BadRecording where the file has no magnetometer or is none."""
    contents = read_messages(path, {*MAG_TOPICS, *_TOPICS})
    topics: dict[str, list[Topic]] = {}
    for topic in contents.topics:
        topics.setdefault(topic.name, []).append(topic)
    history = changes(contents.parameters, [0.0])
    parameters = {change.name: change.value for change in history}
    found, notes = compasses(topics, history, parameters)
    if not found:
        raise NoMagnetometer(
            f"{path} holds no magnetometer: none of {', '.join(MAG_TOPICS)} has samples.",
            "Set SDLOG_PROFILE to include the sensors (bit 0 or 4) and record again.",
            parameters,
        )
    measured: dict[str, Any] = dict(_columns(topics, parameters))
    return Track(
        source=str(path),
        autopilot="px4",
        vehicle=_vehicle(topics),
        compasses=found,
        utc_offset_s=_utc_offset_s(topics),
        parameters=parameters,
        texts=texts_said(contents.texts),
        notes=(*_notes_about_the_file(contents), *notes),
        **measured,
    )


def _notes_about_the_file(contents: ULogContents) -> list[str]:
    notes = damage(contents.skipped_bytes, contents.skipped_stretches, f"{contents.messages} messages")
    lost = contents.dropouts_ms
    if lost:
        notes.append(f"The logger dropped out {len(lost)} times, for {sum(lost) * 1.0e-3:.1f} s in all.")
    return notes


def _columns(topics: Topics, parameters: Mapping[str, float]) -> dict[str, Series]:
    """Build every column that the log gives."""
    out = {
        "acc_mps2": _first(topics, *_ACCELEROMETERS),
        "gyro_radps": _first(topics, *_GYROS),
        "attitude_rad": _attitude(topics),
        "truth_q": _first(topics, ("vehicle_attitude_groundtruth", *indexed("q", 4))),
        "position_ned_m": _first(topics, ("vehicle_local_position", "x", "y", "z")),
        "place": _place(topics),
        "gps_velocity_mps": _gps(topics, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s"),
        "gps_yaw_rad": _gps(topics, "heading", convert=lambda rad: converted("gps_yaw_rad", rad, wrap_pi)),
        "current_a": _current(topics),
        "throttle": _throttle(topics),
        "temperature_degc": _first(topics, ("sensor_baro", "temperature")),
        "motors": _motors(topics, parameters),
    }
    return {name: found for name, found in out.items() if found is not None}


def _vehicle(topics: Topics) -> str:
    """Name the vehicle's kind."""
    for status in topics.get("vehicle_status", ()):
        fields = status.data
        if "system_type" in fields and int(fields["system_type"][-1]) in VEHICLES:
            return VEHICLES[int(fields["system_type"][-1])]
        if "vehicle_type" in fields:
            return _VEHICLE_TYPES.get(int(fields["vehicle_type"][-1]), "unknown")
    return "unknown"


def _utc_offset_s(topics: Topics) -> float | None:
    """Return the Unix time of time_s = 0 by the GPS receiver; None where it had none."""
    for data in _receivers(topics):
        if data.has("time_utc_usec"):
            unix_us = np.asarray(data.data["time_utc_usec"], dtype=np.float64)
            known = unix_us > 0
            if bool(known.any()):
                stamps = np.asarray(data.data["timestamp"], dtype=np.float64)
                return float(np.median(unix_us[known] - stamps[known])) * _MICRO
    return None


def _first(topics: Topics, *choices: tuple[str, ...]) -> Series | None:
    """Read the first of several (topic, fields) that the log has."""
    for topic, *names in choices:
        for data in topics.get(topic, ())[:1]:
            if data.has(*names):
                found = finite_series(data.time_s, data.vector(*names))
                if found is not None:
                    return found
    return None


def _attitude(topics: Topics) -> Series | None:
    q = _first(topics, ("vehicle_attitude", *indexed("q", 4)))
    return None if q is None else Series.of(q.time_s, angles_of(q.values))


def _receivers(topics: Topics) -> list[Topic]:
    return [*topics.get("vehicle_gps_position", ()), *topics.get("sensor_gps", ())]


def _gps(
    topics: Topics, *names: str, convert: Callable[[FloatArray], FloatArray] | None = None
) -> Series | None:
    for data in _receivers(topics):
        if data.has(*names, "fix_type"):
            values = data.vector(*names)
            fixed = np.asarray(data.data["fix_type"]) >= _GPS_FIX_3D
            found = finite_series(data.time_s[fixed], convert(values[fixed]) if convert else values[fixed])
            if found is not None:
                return found
    return None


def _place(topics: Topics) -> Series | None:
    estimate = _first(topics, ("vehicle_global_position", "lat", "lon", "alt"))
    if estimate is not None:
        return estimate
    degrees = _gps(topics, "latitude_deg", "longitude_deg", "altitude_msl_m")
    if degrees is not None:
        return degrees
    return _gps(topics, "lat", "lon", "alt", convert=lambda whole: whole * (_DEG_PER_E7, _DEG_PER_E7, _MILLI))


def _current(topics: Topics) -> Series | None:
    found = _first(topics, ("battery_status", "current_a"))
    if found is None:
        return None
    measured = found.values >= 0.0
    return Series.of(found.time_s[measured], found.values[measured]) if bool(measured.any()) else None


def _throttle(topics: Topics) -> Series | None:
    thrust = _first(topics, ("vehicle_thrust_setpoint", *indexed("xyz")))
    if thrust is not None:
        size = np.linalg.norm(thrust.values, axis=1)
        return Series.of(thrust.time_s, converted("throttle", size, _share))
    control = _first(topics, ("actuator_controls_0", "control[3]"))
    if control is None:
        return None
    return Series.of(control.time_s, converted("throttle", control.values, _share))


def _share(size: FloatArray) -> FloatArray:
    return np.clip(np.nan_to_num(size), 0.0, 1.0)


def _motors(topics: Topics, parameters: Mapping[str, float]) -> Series | None:
    """Read the motors' outputs as fractions; a stopped motor is nan in the log."""
    for data in topics.get("actuator_motors", ())[:1]:
        names = [name for name in indexed("control", 8) if data.has(name)]
        controls = data.vector(*names).reshape(-1, len(names)) if names else np.empty((0, 0))
        used = np.isfinite(controls).any(axis=0)
        if bool(used.any()):
            return Series.of(data.time_s, converted("motors", np.abs(controls[:, used]), _share))
    for data in topics.get("actuator_outputs", ())[:1]:
        count = int(np.max(data.data["noutputs"])) if data.has("noutputs") else 8
        names = [name for name in indexed("output", min(count, 8)) if name in data.data]
        if names:
            outputs = np.abs(np.stack([np.asarray(data.data[name], dtype=np.float64) for name in names]).T)
            credible = np.nan_to_num(outputs[~incredible("motors", outputs)])
            if float(credible.max(initial=0.0)) > _FRACTION:
                fractions = motor_outputs(np.nan_to_num(outputs), {})
                return None if fractions is None else Series.of(data.time_s, fractions)
            return Series.of(data.time_s, converted("motors", outputs, _share))
    return None
