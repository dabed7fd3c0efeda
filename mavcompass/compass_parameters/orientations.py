"""What both autopilots have in common in saying how a compass is mounted: numbers, and angles in degrees.

A mounting is the rotation R from the sensor's axes to the vehicle's, raw_body = R raw_sensor. Free angles are
roll, pitch and yaw, R = Rz(yaw) Ry(pitch) Rx(roll), on both (AP_CustomRotations, PX4's matrix::Eulerf).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mavcompass.frames import SENSOR_ORIENTATIONS_DEG, FloatArray, euler_to_matrix

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
