"""A Track as the messages that its vehicle would have sent: for replaying what was never MAVLink.

Numbers go through the wire's units and integers as the autopilot's firmware sends them: ArduPilot tells
the corrected field in RAW_IMU and SCALED_IMU2/3; PX4 tells the corrected one in HIGHRES_IMU, in gauss, and
the raw one, in the sensor's axes, in SCALED_IMU, SCALED_IMU2 and SCALED_IMU3. A vehicle of unknown make is
played as an ArduPilot vehicle whose parameters say what had been done to its field.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter, itemgetter

import numpy as np

from mavcompass.compass_parameters import px4_correction, px4_sensor_to_body, values
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavAutopilot, MavModeFlag, MavParamType, MavState, MavType
from mavcompass.frames import FloatArray, matrix_to_euler, quaternion_to_matrix
from mavcompass.messages import (
    Attitude,
    GlobalPositionInt,
    GpsRawInt,
    Heartbeat,
    HighresImu,
    Message,
    ParamValue,
    RawImu,
    ScaledImu,
    ScaledImu2,
    ScaledImu3,
    ServoOutputRaw,
    Simstate,
    SysStatus,
    SystemTime,
    VfrHud,
    message_id,
)
from mavcompass.procedure.script import Context
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import DEG_PER_RAD, MGAUSS_PER_GAUSS, MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS
from mavcompass.vehicle.links.autopilot import SaidMessage
from mavcompass.vehicle.parameters.values import Parameter, encode
from mavcompass.vehicle.replay.answers import Contents

_TYPES = {
    "rover": MavType.GROUND_ROVER,
    "boat": MavType.SURFACE_BOAT,
    "copter": MavType.QUADROTOR,
    "sub": MavType.SUBMARINE,
    "plane": MavType.FIXED_WING,
    "vtol": MavType.VTOL_FIXEDROTOR,
}
_IMU_KINDS: dict[int, type[ScaledImu]] = {1: ScaledImu, 2: ScaledImu2, 3: ScaledImu3}
# A Track does not tell types; these are PX4's whole numbers among the parameters of compasses.
_PX4_WHOLE_NUMBERS = re.compile(r"CAL_MAG\d_(ID|ROT|PRIO)|CAL_MAG_(COMP_TYP|SIDES|ROT_AUTO)|SENS_BOARD_ROT")
_INT16 = 32_767
_HIGHRES_MOTION_AND_FIELD = 0x1FF
_SLOW_HZ, _ATTITUDE_HZ = 5.0, 25.0

Build = Callable[[float, int], Message]


def track_contents(track: Track) -> Contents:
    """Say what the vehicle of a Track can be asked."""
    start_s, end_s = _span(track)
    contents = Contents(parameters=track_parameters(track), duration_s=end_s - start_s)
    for said in track_messages(track):
        assert said.message is not None
        number = message_id(type(said.message))
        contents.counts[number] = contents.counts.get(number, 0) + 1
    return contents


def track_messages(track: Track) -> Iterator[SaidMessage]:
    """Hand out the messages in the order of time, which starts at 0 with the Track's first reading."""
    start_s, end_s = _span(track)
    streams = [_beats(track, start_s, end_s), _changes(track, start_s)]
    streams += [_compass(track, instance, start_s) for instance in track.compasses]
    streams += [stream for stream in _slow_streams(track, start_s) if stream is not None]
    return heapq.merge(*streams, key=attrgetter("time_s"))


def _span(track: Track) -> tuple[float, float]:
    series = [compass.reported for compass in track.compasses.values()]
    others = (track.acc_mps2, track.attitude_rad, track.place, track.current_a)
    series += [one for one in others if one is not None]
    times = [one.time_s for one in series if len(one)] or [np.zeros(1)]
    return float(min(t[0] for t in times)), float(max(t[-1] for t in times))


def _said(time_s: float, start_s: float, message: Message) -> SaidMessage:
    return SaidMessage(time_s - start_s, 1, 1, message)


def _stream(series: Series, start_s: float, rate_hz: float | None, build: Build) -> Iterator[SaidMessage]:
    """Build a message for each sample, or for some where fewer are enough; `build` gets time and row."""
    next_s = -np.inf
    for row, time_s in enumerate(series.time_s.tolist()):
        if rate_hz is not None:
            if time_s < next_s:
                continue
            next_s = time_s + 1.0 / rate_hz - 1e-6
        yield _said(time_s, start_s, build(time_s, row))


def _beats(track: Track, start_s: float, end_s: float) -> Iterator[SaidMessage]:
    is_px4 = track.autopilot == "px4"
    beat = Heartbeat(
        type=_TYPES.get(track.vehicle, MavType.GENERIC),
        autopilot=MavAutopilot.PX4 if is_px4 else MavAutopilot.ARDUPILOTMEGA,
        base_mode=MavModeFlag.CUSTOM_MODE_ENABLED,
        system_status=MavState.STANDBY,
    )
    for time_s in np.arange(start_s, end_s + 1.0, 1.0).tolist():
        yield _said(time_s, start_s, beat)
        if track.utc_offset_s is not None:
            unix_us = max(round((track.utc_offset_s + time_s) * 1e6), 0)
            yield _said(time_s, start_s, SystemTime(unix_us, _boot_ms(time_s)))


# --- parameters ----------------------------------------------------------------------------------


def _changes(track: Track, start_s: float) -> Iterator[SaidMessage]:
    for time_s, value in _parameter_changes(track):
        yield _said(max(time_s, start_s), start_s, value)


def track_parameters(track: Track) -> dict[str, ParamValue]:
    """Tell the recording's parameters, each compass's correction as it was at the start."""
    held = dict(track.parameters)
    for instance, compass in track.compasses.items():
        known = track.autopilot == "px4" and any(name.startswith("CAL_MAG") for name in held)
        if not known:
            held |= values(track.autopilot, track.parameters, instance, compass.in_force[0].correction)
    told = enumerate(sorted(held.items()))
    return {name: _parameter_value(track, name, value, i, len(held)) for i, (name, value) in told}


def _parameter_changes(track: Track) -> list[tuple[float, ParamValue]]:
    """Return the corrections that came into force on the way, as values with their times."""
    changes = []
    for instance, compass in track.compasses.items():
        for before, after in zip(compass.in_force[:-1], compass.in_force[1:], strict=True):
            old, new = (
                values(track.autopilot, track.parameters, instance, step.correction)
                for step in (before, after)
            )
            for name, value in new.items():
                if old.get(name) != value:
                    said = _parameter_value(track, name, value, 65_535, len(track.parameters))
                    changes.append((after.from_s, said))
    return sorted(changes, key=itemgetter(0))


def _parameter_value(track: Track, name: str, value: float, index: int, count: int) -> ParamValue:
    """Spell a parameter as its autopilot does on the wire."""
    whole = track.autopilot == "px4" and _PX4_WHOLE_NUMBERS.fullmatch(name) is not None
    kind = MavParamType.INT32 if whole else MavParamType.REAL32
    wire = encode(name, Parameter(value, kind), "bytewise" if whole else "cast", Context())
    return ParamValue(name, wire.param_value, kind, count, index)


# --- compasses and IMU ---------------------------------------------------------------------------


def _compass(track: Track, instance: int, start_s: float) -> Iterator[SaidMessage]:
    compass = track.compasses[instance]
    time_s = compass.time_s
    acc, gyro = (_at(series, time_s) for series in (track.acc_mps2, track.gyro_radps))
    if track.autopilot != "px4":
        return _imu(instance, compass.reported, acc, gyro, start_s, RawImu if instance == 1 else None)
    raw = track.raw_field(instance)
    in_sensor_axes = Series(time_s, raw @ px4_sensor_to_body(track.parameters, instance))
    scaled = _imu(instance, in_sensor_axes, acc, gyro, start_s)
    if instance != 1:
        return scaled
    return heapq.merge(scaled, _highres(track, compass, raw, acc, gyro, start_s), key=attrgetter("time_s"))


def _at(series: Series | None, time_s: FloatArray) -> FloatArray:
    return np.zeros((len(time_s), 3)) if series is None else series.at(time_s)


def _imu(
    instance: int,
    field: Series,
    acc_mps2: FloatArray,
    gyro_radps: FloatArray,
    start_s: float,
    raw_imu: type[RawImu] | None = None,
) -> Iterator[SaidMessage]:
    whole = np.hstack([acc_mps2 / MPS2_PER_MILLI_G, gyro_radps / RADPS_PER_MILLIRADPS, field.values])
    # Firmware casts to int16, which cuts the fraction off; what was whole before the units changed stays so.
    rows = np.clip(np.nan_to_num(whole.round(6)), -_INT16, _INT16).astype(int).tolist()
    kind = _IMU_KINDS[instance]

    def build(time_s: float, row: int) -> Message:
        if raw_imu is not None:
            return raw_imu(_boot_us(time_s), *rows[row])
        return kind(_boot_ms(time_s), *rows[row])

    return _stream(field, start_s, None, build)


def _highres(
    track: Track, compass: MagSeries, raw: FloatArray, acc: FloatArray, gyro: FloatArray, start_s: float
) -> Iterator[SaidMessage]:
    correction = _correction_in_use(track, compass)
    load = track.load_of(correction, compass.time_s)
    field_gauss = correction.apply(raw, load) / MGAUSS_PER_GAUSS
    rows = np.hstack([acc, gyro, field_gauss]).tolist()

    def build(time_s: float, row: int) -> Message:
        return replace(HighresImu(_boot_us(time_s), *rows[row]), fields_updated=_HIGHRES_MOTION_AND_FIELD)

    return _stream(compass.reported, start_s, None, build)


def _correction_in_use(track: Track, compass: MagSeries) -> FieldCorrection:
    """Return what PX4 does to the field: by its parameters, for a ULog's raw readings do not have it."""
    if any(name.startswith("CAL_MAG") for name in track.parameters):
        return px4_correction(track.parameters, compass.instance)
    return compass.in_force[-1].correction


# --- the slower ones -----------------------------------------------------------------------------


def _slow_streams(track: Track, start_s: float) -> Iterator[Iterator[SaidMessage] | None]:
    yield _of(track.attitude_rad, start_s, _ATTITUDE_HZ, _attitude)
    yield _of(track.place, start_s, _SLOW_HZ, lambda values: _position(track, values))
    yield _of(track.place, start_s, _SLOW_HZ, lambda values: _gps(track, values))
    yield _of(track.current_a, start_s, _SLOW_HZ, _battery)
    yield _of(track.throttle, start_s, _SLOW_HZ, _hud)
    yield _of(track.motors, start_s, _SLOW_HZ, _motors)
    yield _of(track.truth_q, start_s, _ATTITUDE_HZ, _truth)


def _of(
    series: Series | None, start_s: float, rate_hz: float, builder: Callable[[Series], Build]
) -> Iterator[SaidMessage] | None:
    return None if series is None else _stream(series, start_s, rate_hz, builder(series))


def _attitude(series: Series) -> Build:
    return lambda time_s, row: Attitude(_boot_ms(time_s), *series.values[row].tolist())


def _position(track: Track, place: Series) -> Build:
    velocity = _velocity(track, place)
    alt0_m = float(place.values[0, 2])

    def build(time_s: float, row: int) -> Message:
        lat, lon, alt = place.values[row].tolist()
        centimetres = np.clip(velocity[row] * 100.0, -_INT16, _INT16).astype(int).tolist()
        where = (round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), round((alt - alt0_m) * 1e3))
        return GlobalPositionInt(_boot_ms(time_s), *where, *centimetres)

    return build


def _gps(track: Track, place: Series) -> Build:
    velocity = _velocity(track, place)
    yaw = None if track.gps_yaw_rad is None else np.unwrap(track.gps_yaw_rad.values)
    yaw_rad = None if yaw is None else np.interp(place.time_s, track.gps_yaw_rad.time_s, yaw)  # type: ignore[union-attr]

    def build(time_s: float, row: int) -> Message:
        lat, lon, alt = place.values[row].tolist()
        north, east, _ = velocity[row].tolist()
        course = np.arctan2(east, north) * DEG_PER_RAD % 360.0
        # 0 means "no yaw", so north is 36000.
        yaw_cdeg = 0 if yaw_rad is None else round(yaw_rad[row] * DEG_PER_RAD % 360.0 * 100.0) or 36_000
        return GpsRawInt(
            _boot_us(time_s),
            fix_type=3,
            lat=round(lat * 1e7),
            lon=round(lon * 1e7),
            alt=round(alt * 1e3),
            vel=min(round(float(np.hypot(north, east)) * 100.0), 65_534),
            cog=round(float(course) * 100.0) % 36_000,
            yaw=yaw_cdeg,
        )

    return build


def _velocity(track: Track, place: Series) -> FloatArray:
    if track.gps_velocity_mps is None:
        return np.zeros((len(place), 3))
    return np.nan_to_num(track.gps_velocity_mps.at(place.time_s))


def _battery(series: Series) -> Build:
    centiamps = np.where(np.isfinite(series.values), np.clip(series.values * 100.0, 0, _INT16), -1.0)
    return lambda time_s, row: SysStatus(current_battery=round(float(centiamps[row])))


def _hud(series: Series) -> Build:
    percent = np.clip(np.nan_to_num(series.values) * 100.0, 0, 100)
    return lambda time_s, row: VfrHud(throttle=round(float(percent[row])))


def _motors(series: Series) -> Build:
    pulses = np.rint(1000.0 + 1000.0 * np.clip(np.nan_to_num(series.values), 0.0, 1.0)).astype(int)
    return lambda time_s, row: ServoOutputRaw(_boot_us(time_s) & 0xFFFFFFFF, 0, *pulses[row, :8].tolist())


def _truth(series: Series) -> Build:
    euler = np.stack(matrix_to_euler(quaternion_to_matrix(series.values)), axis=-1)
    return lambda time_s, row: Simstate(*euler[row].tolist())


def _boot_ms(time_s: float) -> int:
    return max(round(time_s * 1e3), 0) & 0xFFFFFFFF


def _boot_us(time_s: float) -> int:
    return max(round(time_s * 1e6), 0)
