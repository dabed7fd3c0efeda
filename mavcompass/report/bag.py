"""A recording and what is said of it as an MCAP file: ROS 2 messages for Foxglove, PlotJuggler or Rerun.

The raw field is a `sensor_msgs/MagneticField`, so that the file is a recording again; what was made of it
goes beside it as vectors in milligauss. Body axes are forward, left, up (REP 103); a heading is an azimuth as
the compass packages of ROS have it (compass_interfaces/Azimuth: clockwise from north, with its variance).
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mavcompass.attitude import levels
from mavcompass.earth_field import earth_field_of
from mavcompass.errors import MavCompassError
from mavcompass.frames import FloatArray, euler_to_quaternion, level_to_body, rotate, tilt_from_acceleration
from mavcompass.heading.evidence import heading_of_track
from mavcompass.heading.one_compass import HeadingResult
from mavcompass.installation.parts import require
from mavcompass.logs.formats.ros import FLU_TO_FRD, MGAUSS_PER_TESLA
from mavcompass.track import Track

_AZIMUTH = """std_msgs/Header header
float64 azimuth
float64 variance
uint8 UNIT_RAD=0
uint8 UNIT_DEG=1
uint8 unit
uint8 ORIENTATION_ENU=0
uint8 ORIENTATION_NED=1
uint8 orientation
uint8 REFERENCE_MAGNETIC=0
uint8 REFERENCE_GEOGRAPHIC=1
uint8 REFERENCE_UTM=2
uint8 reference
"""
_DEGREES, _CLOCKWISE, _MAGNETIC, _TRUE = 1, 1, 0, 1
_OK, _WARN = 0, 1  # diagnostic_msgs
_UNKNOWN = np.zeros(9)  # a covariance of zeros is one that is not known
_FRAME = "base_link"


class _Messages:
    """Make messages of the types that are written."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(_AZIMUTH, "compass_interfaces/msg/Azimuth"))

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, time_s: float) -> Any:
        whole = math.floor(time_s)
        stamp = self.make("builtin_interfaces/msg/Time", sec=whole, nanosec=int((time_s - whole) * 1e9))
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=_FRAME)

    def vector(self, xyz: Sequence[float]) -> Any:
        return self.make("geometry_msgs/msg/Vector3", x=xyz[0], y=xyz[1], z=xyz[2])


# A topic, its type, when, and all but the header.
_Row = tuple[str, str, float, dict[str, Any]]


def write_bag(track: Track, path: Path, known: Mapping[int, HeadingResult] = MappingProxyType({})) -> None:
    """Write a recording, its headings, and how far each compass is from the Earth's field, to an MCAP file.

    Topics: `/imu`, `/fix`; for each compass N `/compass_N/raw` (tesla), `/compass_N/field` (corrected by what
    is in force), `/compass_N/residual` (that less the Earth's field at its own heading; both milligauss),
    `/compass_N/magnetic` and `/compass_N/true` (azimuths), and in `/diagnostics` what a calibration says.

    `known` are headings of compasses, from 1, that were computed before: they are not computed again.

    Raises UsageError where the rosbags package is missing, BadRecording where a heading cannot be computed.
    """
    require("A ROS 2 bag")
    from rosbags.rosbag2 import StoragePlugin, Writer

    messages = _Messages()
    start_s = track.utc_offset_s or 0.0
    rows = sorted((*_vehicle(track, messages), *_compasses(track, messages, known)), key=lambda row: row[2])
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / path.stem
        topics: dict[str, Any] = {}
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, kind, time_s, values in rows:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=messages.store)
                at_s = max(time_s + start_s, 0.0)
                message = messages.make(kind, header=messages.header(at_s), **values)
                raw = messages.store.serialize_cdr(message, kind)
                writer.write(topics[topic], round(at_s * 1e9), raw)
        os.replace(bag / f"{path.stem}.mcap", path)


def _vehicle(track: Track, messages: _Messages) -> Iterator[_Row]:
    """Yield what does not belong to a compass: acceleration, rates, attitude, place."""
    if track.acc_mps2 is not None and track.gyro_radps is not None:
        time_s = track.acc_mps2.time_s
        force, rates = track.acc_mps2.values * FLU_TO_FRD, track.gyro_radps.at(time_s) * FLU_TO_FRD
        turned = np.zeros((len(time_s), 4))  # all zero: not known
        if track.attitude_rad is not None:
            roll, pitch, yaw = track.attitude_rad.nearest(time_s, 1.0).T
            turned = np.nan_to_num(euler_to_quaternion(roll, -pitch, 0.5 * math.pi - yaw))
        for at_s, f, w, q in zip(
            time_s.tolist(), force.tolist(), rates.tolist(), turned.tolist(), strict=True
        ):
            quaternion = messages.make("geometry_msgs/msg/Quaternion", w=q[0], x=q[1], y=q[2], z=q[3])
            values = {
                "orientation": quaternion,
                "orientation_covariance": _UNKNOWN,
                "angular_velocity": messages.vector(w),
                "angular_velocity_covariance": _UNKNOWN,
                "linear_acceleration": messages.vector(f),
                "linear_acceleration_covariance": _UNKNOWN,
            }
            yield "/imu", "sensor_msgs/msg/Imu", at_s, values
    if track.place is not None:
        status = messages.make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
        for at_s, (lat, lon, alt) in zip(
            track.place.time_s.tolist(), track.place.values.tolist(), strict=True
        ):
            values = {
                "status": status,
                "latitude": lat,
                "longitude": lon,
                "altitude": alt,
                "position_covariance": _UNKNOWN,
                "position_covariance_type": 0,
            }
            yield "/fix", "sensor_msgs/msg/NavSatFix", at_s, values


def _compasses(track: Track, messages: _Messages, known: Mapping[int, HeadingResult]) -> Iterator[_Row]:
    """Yield what each compass read, what it was made into, and what a calibration of it says."""
    said = []
    for instance, compass in sorted(track.compasses.items()):
        topic = f"/compass_{instance}"
        raw = track.raw_field(instance) * FLU_TO_FRD / MGAUSS_PER_TESLA
        for at_s, row in zip(compass.time_s.tolist(), raw.tolist(), strict=True):
            values = {"magnetic_field": messages.vector(row), "magnetic_field_covariance": _UNKNOWN}
            yield f"{topic}/raw", "sensor_msgs/msg/MagneticField", at_s, values
        heading = known.get(instance) or heading_of_track(track, None, instance)
        vectors = {"field": compass.reported.values, "residual": _residual(track, heading, instance)}
        for name, column in vectors.items():
            if column is None:
                continue
            for at_s, row in zip(heading.time_s.tolist(), (column * FLU_TO_FRD).tolist(), strict=True):
                values = {"vector": messages.vector(row)}
                yield f"{topic}/{name}", "geometry_msgs/msg/Vector3Stamped", at_s, values
        for name, north, angles, sigma in (
            ("magnetic", _MAGNETIC, heading.magnetic_rad, heading.magnetic_sigma_rad),
            ("true", _TRUE, heading.true_rad, heading.sigma_rad),
        ):
            if angles is None:
                continue
            how = {"unit": _DEGREES, "orientation": _CLOCKWISE, "reference": north}
            columns = (heading.time_s, np.degrees(angles), np.degrees(sigma) ** 2)
            for at_s, angle, variance in zip(*(column.tolist() for column in columns), strict=True):
                values = {"azimuth": angle, "variance": variance, **how}
                yield f"{topic}/{name}", "compass_interfaces/msg/Azimuth", at_s, values
        said.append(_verdict(track, instance, messages))
    yield "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _end_s(track), {"status": said}


def _end_s(track: Track) -> float:
    return max(float(compass.time_s[-1]) for compass in track.compasses.values() if len(compass.reported))


def _residual(track: Track, heading: HeadingResult, instance: int) -> FloatArray | None:
    """Return the corrected field less the Earth's at its own heading, body FRD, mG; None without a place."""
    world = earth_field_of(track)
    if world is None:
        return None
    roll, pitch = tilt_from_acceleration(-levels(track).at(heading.time_s))
    plain = (world.horizontal_mgauss, 0.0, world.ned_mgauss[2])
    earth = rotate(level_to_body(roll, pitch, heading.magnetic_rad), plain)
    return np.asarray(track.compasses[instance].reported.values - earth)


def _verdict(track: Track, instance: int, messages: _Messages) -> Any:
    """Return what a calibration by this recording says; OK where the values in force are right."""
    from mavcompass.calibration import calibrate_track
    from mavcompass.calibration.result import summary

    level = _WARN
    try:
        result = calibrate_track(track, instance=instance)
        text = " ".join((summary(result), *result.reasons))
        level = _OK if result.already_right else _WARN
    except MavCompassError as error:
        text = str(error)
    name, identity = f"Compass {instance}", str(track.compasses[instance].device_id or "")
    values = {"level": level, "name": name, "message": text, "hardware_id": identity, "values": []}
    return messages.make("diagnostic_msgs/msg/DiagnosticStatus", **values)
