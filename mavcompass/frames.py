"""Angles, rotations and the two frames: world NED and body FRD.

A rotation `R` (or its quaternion `q`, scalar first) takes body vectors to world vectors,
`v_ned = R @ v_frd`. Euler angles are aerospace roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll).
Arrays carry the samples in the first axis.

Which way a sensor is mounted is the rotation R from its axes to the vehicle's, raw_body = R raw_sensor, a
number or free angles in degrees, R = Rz(yaw) Ry(pitch) Rx(roll), on both autopilots (AP_CustomRotations,
PX4's matrix::Eulerf).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
# The sigma of a heading of which nothing is known: all of the circle is as likely.
NO_HEADING_RAD = math.pi / math.sqrt(3.0)


def wrap_pi(angle_rad: ArrayLike) -> Any:
    """Bring angles into [-pi, pi)."""
    return (np.asarray(angle_rad, dtype=np.float64) + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angle(angle_rad: float) -> float:
    """Bring one angle into [-pi, pi), without the cost of an array."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def wrap_two_pi(angle_rad: ArrayLike) -> Any:
    """Bring angles into [0, 2 pi)."""
    wrapped = np.asarray(angle_rad, dtype=np.float64) % (2.0 * math.pi)
    # -1e-17 % 2pi rounds to 2pi itself.
    return np.where(wrapped >= 2.0 * math.pi, 0.0, wrapped)


def circular_mean(angle_rad: ArrayLike) -> float:
    """Average angles on the circle; nan where they cancel out."""
    total = np.exp(1j * np.asarray(angle_rad, dtype=np.float64)).sum()
    return float(np.angle(total)) if abs(total) > 0.0 else math.nan


def circle_covered_rad(angle_rad: ArrayLike) -> float:
    """Return how much of the circle angles (N,) cover: all but their widest gap."""
    ordered = np.sort(np.asarray(angle_rad, dtype=np.float64) % (2.0 * math.pi))
    return 2.0 * math.pi - float(np.diff(ordered, append=ordered[0] + 2.0 * math.pi).max())


def euler_to_matrix(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Build body-to-world rotation matrices, shape (..., 3, 3), from aerospace Euler angles."""
    roll, pitch, yaw = np.broadcast_arrays(
        *(np.asarray(a, dtype=np.float64) for a in (roll_rad, pitch_rad, yaw_rad))
    )
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    matrix = np.empty((*roll.shape, 3, 3))
    matrix[..., 0, 0] = cp * cy
    matrix[..., 0, 1] = sr * sp * cy - cr * sy
    matrix[..., 0, 2] = cr * sp * cy + sr * sy
    matrix[..., 1, 0] = cp * sy
    matrix[..., 1, 1] = sr * sp * sy + cr * cy
    matrix[..., 1, 2] = cr * sp * sy - sr * cy
    matrix[..., 2, 0] = -sp
    matrix[..., 2, 1] = sr * cp
    matrix[..., 2, 2] = cr * cp
    return matrix


def matrix_to_euler(matrix: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Read roll, pitch, yaw off body-to-world rotation matrices of shape (..., 3, 3)."""
    m = np.asarray(matrix, dtype=np.float64)
    roll = np.arctan2(m[..., 2, 1], m[..., 2, 2])
    pitch = np.arcsin(np.clip(-m[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(m[..., 1, 0], m[..., 0, 0])
    return roll, pitch, yaw


def euler_to_quaternion(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Build quaternions (w, x, y, z), shape (..., 4), from aerospace Euler angles."""
    half = [np.asarray(a, dtype=np.float64) / 2.0 for a in (roll_rad, pitch_rad, yaw_rad)]
    cr, sr, cp, sp, cy, sy = (f(a) for a in half for f in (np.cos, np.sin))
    return np.stack(
        np.broadcast_arrays(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )


def quaternion_to_matrix(quaternion: ArrayLike) -> FloatArray:
    """Build rotation matrices, shape (..., 3, 3), from unit quaternions (w, x, y, z)."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = (q[..., i] for i in range(4))
    matrix = np.empty((*q.shape[:-1], 3, 3))
    matrix[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[..., 0, 1] = 2.0 * (x * y - w * z)
    matrix[..., 0, 2] = 2.0 * (x * z + w * y)
    matrix[..., 1, 0] = 2.0 * (x * y + w * z)
    matrix[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[..., 1, 2] = 2.0 * (y * z - w * x)
    matrix[..., 2, 0] = 2.0 * (x * z - w * y)
    matrix[..., 2, 1] = 2.0 * (y * z + w * x)
    matrix[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return matrix


def rotate(matrix: ArrayLike, vector: ArrayLike) -> FloatArray:
    """Take body vectors (..., 3) to the world by rotation matrices (..., 3, 3)."""
    return np.einsum("...ij,...j->...i", np.asarray(matrix), np.asarray(vector))


def rotate_back(matrix: ArrayLike, vector: ArrayLike) -> FloatArray:
    """Take world vectors (..., 3) to the body by rotation matrices (..., 3, 3)."""
    return np.einsum("...ji,...j->...i", np.asarray(matrix), np.asarray(vector))


def level_to_body(roll_rad: ArrayLike, pitch_rad: ArrayLike, turned_rad: ArrayLike = 0.0) -> FloatArray:
    """Build the rotations (..., 3, 3) to body axes from level ones, which lie back by the angle turned."""
    return np.swapaxes(euler_to_matrix(roll_rad, pitch_rad, turned_rad), -1, -2)


def cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the vector products of rows, (N, 3); numpy's takes three times as long for hundreds of them."""
    (a, b, c), (d, e, f) = first.T, second.T
    out = np.empty(first.shape)
    out[:, 0], out[:, 1], out[:, 2] = b * f - c * e, c * d - a * f, a * e - b * d
    return out


def rotvec_to_matrix(vectors_rad: ArrayLike) -> FloatArray:
    """Return the rotations (..., 3, 3) by vectors (..., 3), about them by their lengths.

    Rodrigues' formula: I + f K + g K^2, K taking the cross product with the vector.
    """
    vectors = np.asarray(vectors_rad, dtype=np.float64)
    x, y, z = np.moveaxis(vectors, -1, 0)
    half = 0.5 * np.maximum(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)), 1e-9)
    # f = sin a / a, and g = (1 - cos a) / a^2 without a difference of what is nearly the same.
    sine = np.sin(half) / half
    f, g = sine * np.cos(half), 0.5 * sine * sine
    gx, gy, gz, fx, fy, fz = g * x, g * y, g * z, f * x, f * y, f * z
    xx, yy, zz, xy, xz, yz = gx * x, gy * y, gz * z, gx * y, gx * z, gy * z
    out = np.empty((*vectors.shape, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1.0 - yy - zz, xy - fz, xz + fy
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = xy + fz, 1.0 - xx - zz, yz - fx
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = xz - fy, yz + fx, 1.0 - xx - yy
    return out


def matrix_to_rotvec(rotations: FloatArray) -> FloatArray:
    """Return the vectors (N, 3) that rotations (N, 3, 3) turn about: the inverse of `rotvec_to_matrix`."""
    axis = 0.5 * (rotations[:, [2, 0, 1], [1, 2, 0]] - rotations[:, [1, 2, 0], [2, 0, 1]])
    sine = np.sqrt(np.einsum("ni,ni->n", axis, axis))
    angle = np.arctan2(sine, 0.5 * (np.einsum("nii->n", rotations) - 1.0))
    factor = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)
    return np.asarray(axis * factor[:, None])


def tilt_from_acceleration(acceleration_mps2: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Read roll and pitch off the specific force of a vehicle at rest, shape (..., 3).

    At rest an accelerometer in FRD axes reads (0, 0, -g).
    """
    a = np.asarray(acceleration_mps2, dtype=np.float64)
    roll = np.arctan2(-a[..., 1], -a[..., 2])
    pitch = np.arctan2(a[..., 0], np.hypot(a[..., 1], a[..., 2]))
    return roll, pitch


# MAV_SENSOR_ORIENTATION, the numbers of COMPASS_ORIENT and CAL_MAGn_ROT: (roll, pitch, yaw) in degrees.
SENSOR_ORIENTATIONS_DEG: dict[int, tuple[float, float, float]] = {
    **{i: (0.0, 0.0, 45.0 * i) for i in range(8)},
    **{8 + i: (180.0, 0.0, 45.0 * i) for i in range(8)},
    12: (0.0, 180.0, 0.0),
    16: (90.0, 0.0, 0.0),
    17: (90.0, 0.0, 45.0),
    18: (90.0, 0.0, 90.0),
    19: (90.0, 0.0, 135.0),
    20: (270.0, 0.0, 0.0),
    21: (270.0, 0.0, 45.0),
    22: (270.0, 0.0, 90.0),
    23: (270.0, 0.0, 135.0),
    24: (0.0, 90.0, 0.0),
    25: (0.0, 270.0, 0.0),
    26: (0.0, 180.0, 90.0),
    27: (0.0, 180.0, 270.0),
    28: (90.0, 90.0, 0.0),
    29: (180.0, 90.0, 0.0),
    30: (270.0, 90.0, 0.0),
    31: (90.0, 180.0, 0.0),
    32: (270.0, 180.0, 0.0),
    33: (90.0, 270.0, 0.0),
    34: (180.0, 270.0, 0.0),
    35: (270.0, 270.0, 0.0),
    36: (90.0, 180.0, 90.0),
    37: (90.0, 0.0, 270.0),
    38: (90.0, 68.0, 293.0),
    39: (0.0, 315.0, 0.0),
    40: (90.0, 315.0, 0.0),
    41: (0.0, 7.0, 0.0),
    42: (45.0, 0.0, 0.0),
    43: (315.0, 0.0, 0.0),
}


def sensor_orientation_matrix(orientation: int) -> FloatArray:
    """Build the sensor-to-body rotation, shape (3, 3), of a MAV_SENSOR_ORIENTATION number.

    Raises KeyError for a number outside the table (custom angles are not in it).
    """
    return euler_to_matrix(*np.radians(SENSOR_ORIENTATIONS_DEG[orientation]))


# Motion shows a mounting to half a degree at best: nearer to a numbered one, a measured mounting is that one,
# and a number needs neither a free slot nor a restart.
NUMBERED_WITHIN_RAD = math.radians(0.5)

Orientations = Mapping[int, FloatArray]


def rotation_of(angles_deg: Sequence[float]) -> FloatArray:
    """Build the rotation, shape (3, 3), of roll, pitch and yaw in degrees."""
    return euler_to_matrix(*np.radians(angles_deg))


NUMBERED: Orientations = {number: rotation_of(angles) for number, angles in SENSOR_ORIENTATIONS_DEG.items()}


def angles_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Read roll, pitch and yaw in degrees off a rotation, shape (3, 3).

    At a pitch of 90 degrees roll and yaw turn about one axis: yaw is what the roll found leaves.
    """
    m = rotation
    roll = math.atan2(m[2, 1], m[2, 2])
    pitch = math.atan2(-m[2, 0], math.hypot(m[2, 1], m[2, 2]))
    sine, cosine = math.sin(roll), math.cos(roll)
    yaw = math.atan2(sine * m[0, 2] - cosine * m[0, 1], cosine * m[1, 1] - sine * m[1, 2])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def angle_between(first: FloatArray, second: FloatArray) -> float:
    """Return by how much, in radians, two rotations (3, 3) differ: |A - B| = 2 sqrt(2) sin(angle / 2)."""
    return 2.0 * math.asin(min(float(np.linalg.norm(first - second)) / math.sqrt(8.0), 1.0))


def nearest(rotation: FloatArray, orientations: Orientations) -> tuple[int, float]:
    """Find the orientation next to a rotation: its number (the lowest of equal ones), how far it is, rad."""
    off = {number: angle_between(rotation, one) for number, one in orientations.items()}
    number = min(off, key=lambda n: (round(off[n], 9), n))
    return number, off[number]


def spelled(rotation: FloatArray) -> str:
    """Say a rotation in words."""
    roll, pitch, yaw = (f"{angle + 0.0:.1f}" for angle in angles_of(rotation))
    return f"roll {roll}, pitch {pitch}, yaw {yaw} degrees"


def nearest_in_words(rotation: FloatArray, orientations: Orientations) -> str:
    """Say which orientation is next to a rotation that none is equal to."""
    number, off_rad = nearest(rotation, orientations)
    return f"the nearest one, {number}, is {math.degrees(off_rad):.1f} degrees off"
