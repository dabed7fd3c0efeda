"""ROS 2 bags (MCAP or SQLite, as rosbag2 writes them; no ROS is needed): MagneticField, Imu, NavSatFix.

ROS has its body axes forward, left, up and its world axes east, north, up (REP 103, REP 105); a field is told
in tesla. A bag that mavros filled is one of these, too.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.correction import IDENTITY
from mavcompass.credible import converted
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, matrix_to_euler, quaternion_to_matrix
from mavcompass.installation.parts import require
from mavcompass.logs.common.samples import finite_series
from mavcompass.track import InForce, MagSeries, Series, Track

NAME = "ROS 2 bag (.mcap, .db3)"
SUFFIXES = (".mcap", ".db3")
_MAGIC = (b"\x89MCAP", b"SQLite format 3\0")
_FIELD, _IMU, _FIX = (f"sensor_msgs/msg/{name}" for name in ("MagneticField", "Imu", "NavSatFix"))
MGAUSS_PER_TESLA = 1.0e7
FLU_TO_FRD = np.array([1.0, -1.0, -1.0])
_ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
Rows = dict[tuple[str, str], list[tuple[float, ...]]]
_REMEDY = "Give the .mcap or .db3 file of a bag with sensor_msgs/MagneticField in it."


def recognises(head: bytes) -> bool:
    """Tell whether a file begins as one of the two storages does."""
    return head.startswith(_MAGIC)


def read(path: Path, head: bytes) -> dict[int, Track]:
    """Read the one vehicle of a bag; each topic with a magnetic field is a compass, in the order of names."""
    require("A ROS 2 bag")
    rows, notes = _messages(path)
    fields = sorted(topic for kind, topic in rows if kind == _FIELD)
    if not fields:
        raise BadRecording(f"{path} holds no sensor_msgs/MagneticField.", _REMEDY)
    compasses = {}
    for instance, topic in enumerate(fields, 1):
        time_s, values = _column(rows[_FIELD, topic])
        reported = finite_series(time_s, values * FLU_TO_FRD * MGAUSS_PER_TESLA)
        if reported is not None:
            compasses[instance] = MagSeries(instance, reported, (InForce(-np.inf, IDENTITY),))
        notes.append(f"Compass {instance} is {topic}.")
    found: dict[str, Series] = {}
    if imu := _fullest(rows, _IMU):
        time_s, values = _column(rows[_IMU, imu])
        found["acc_mps2"] = Series.of(time_s, values[:, :3] * FLU_TO_FRD)
        found["gyro_radps"] = Series.of(time_s, values[:, 3:6] * FLU_TO_FRD)
        told = np.linalg.norm(values[:, 6:], axis=1) > 0.5  # all zero where the sensor has no orientation
        if told.any():
            angles = converted("truth_q", values[told, 6:], _euler_rad)
            found["attitude_rad"] = Series.of(time_s[told], angles)
        notes.append(f"Attitude, gyro and accelerometer are {imu}.")
    if fix := _fullest(rows, _FIX):
        found["place"] = Series.of(*_column(rows[_FIX, fix]))
    return {1: Track(source=str(path), compasses=compasses, notes=tuple(notes), **found)}  # type: ignore[arg-type]


def _euler_rad(flu_to_enu: FloatArray) -> FloatArray:
    turned = _ENU_TO_NED @ quaternion_to_matrix(flu_to_enu) * FLU_TO_FRD
    return np.stack(matrix_to_euler(turned), axis=1)


def _fullest(rows: Rows, kind: str) -> str:
    """Return the topic with most messages of a kind, "" where there is none."""
    return max((t for of, t in rows if of == kind), key=lambda topic: len(rows[kind, topic]), default="")


def _messages(path: Path) -> tuple[Rows, list[str]]:
    """Read what is wanted, by message type and topic: time, then the numbers. Raises BadRecording."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    rows: Rows = defaultdict(list)
    lost: Counter[str] = Counter()
    types: Any = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with Reader(path) as bag:
            wanted = [c for c in bag.connections if c.msgtype in _NUMBERS]
            for connection, stored_ns, raw in bag.messages(connections=wanted):
                try:
                    message: Any = types.deserialize_cdr(raw, connection.msgtype)
                    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                    numbers = _NUMBERS[connection.msgtype](message)
                except Exception:  # whatever a damaged message makes the library stumble over
                    lost[connection.topic] += 1
                    continue
                rows[connection.msgtype, connection.topic].append((stamp or 1e-9 * stored_ns, *numbers))
    except Exception as error:  # and a damaged file
        if not rows:
            raise BadRecording(f"{path} cannot be read as a ROS 2 bag ({error}).", _REMEDY) from error
        return rows, [f"The bag is damaged; what was before is read ({error})."]
    return rows, [f"{count} messages of {topic} were damaged." for topic, count in lost.items()]


def _vector(v: Any) -> tuple[float, float, float]:
    return v.x, v.y, v.z


_NUMBERS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    _FIELD: lambda m: _vector(m.magnetic_field),
    _IMU: lambda m: (
        *_vector(m.linear_acceleration),
        *_vector(m.angular_velocity),
        m.orientation.w,
        *_vector(m.orientation),
    ),
    _FIX: lambda m: (m.latitude, m.longitude, m.altitude),
}


def _column(rows: list[tuple[float, ...]]) -> tuple[FloatArray, FloatArray]:
    table = np.array(rows)
    return table[:, 0], table[:, 1:]
