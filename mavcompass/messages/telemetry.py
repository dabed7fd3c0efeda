"""What the numbers in a MAVLink message mean as quantities of a Track.

Each function takes anything with the message's field names as attributes: one message of
`messages`, or a numpy record array holding thousands of them. Vectors come back as (..., 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

# The compass that each message carries. RAW_IMU of ArduPilot is compass 1, corrected like SCALED_IMU;
# PX4 sends SCALED_IMU uncorrected and in the sensor's axes.
MAG_MESSAGES = {"RAW_IMU": 1, "SCALED_IMU": 1, "SCALED_IMU2": 2, "SCALED_IMU3": 3}
FIX_3D, _UNKNOWN_U16 = 3, 65535


def _columns(*columns: Any) -> FloatArray:
    # Turned, not joined along the last axis, so that each column stays contiguous, as a Series wants it.
    return np.array(columns).T


def field_mgauss(imu: Any) -> FloatArray:
    """Read the magnetic field off RAW_IMU or SCALED_IMU, milligauss."""
    return _columns(imu.xmag, imu.ymag, imu.zmag) * 1.0


def acceleration_mps2(imu: Any) -> FloatArray:
    """Read the specific force off RAW_IMU or SCALED_IMU, metres per second squared."""
    return _columns(imu.xacc, imu.yacc, imu.zacc) * MPS2_PER_MILLI_G


def angular_rate_radps(imu: Any) -> FloatArray:
    """Read the angular rate off RAW_IMU or SCALED_IMU, radians per second."""
    return _columns(imu.xgyro, imu.ygyro, imu.zgyro) * RADPS_PER_MILLIRADPS


def imu_vectors(imu: Any) -> tuple[tuple[float, ...], ...]:
    """Read angular rate, specific force and field off one message: as above, without an array for each."""
    w, a = RADPS_PER_MILLIRADPS, MPS2_PER_MILLI_G
    rate, force = (imu.xgyro * w, imu.ygyro * w, imu.zgyro * w), (imu.xacc * a, imu.yacc * a, imu.zacc * a)
    return rate, force, (float(imu.xmag), float(imu.ymag), float(imu.zmag))


def imu_time_s(imu: Any) -> Any:
    """Read the time since boot, seconds, off RAW_IMU (microseconds), SCALED_IMU or others (milliseconds)."""
    if hasattr(imu, "time_usec"):
        return imu.time_usec * 1.0e-6
    return imu.time_boot_ms * 1.0e-3


def euler_rad(attitude: Any) -> FloatArray:
    """Read roll, pitch, yaw off ATTITUDE or SIMSTATE, radians."""
    return _columns(attitude.roll, attitude.pitch, attitude.yaw)


def place(global_position: Any) -> FloatArray:
    """Read latitude deg, longitude deg, altitude m off GLOBAL_POSITION_INT or GPS_RAW_INT."""
    return _columns(
        np.asarray(global_position.lat) * 1.0e-7,
        np.asarray(global_position.lon) * 1.0e-7,
        np.asarray(global_position.alt) * 1.0e-3,
    )


def second_antenna_rad(gps_raw: Any) -> FloatArray:
    """Read a second antenna's true yaw off GPS_RAW_INT, -pi to pi; nan where there is none."""
    yaw = np.asarray(gps_raw.yaw, dtype=np.float64)
    known = (yaw > 0) & (yaw != _UNKNOWN_U16)
    return np.asarray(wrap_pi(np.where(known, np.radians(0.01 * yaw), np.nan)))


def ground_velocity_mps(gps_raw: Any) -> FloatArray:
    """Read the receiver's velocity off GPS_RAW_INT: north, east, and down, which it does not tell (nan).

    All are nan where it has no fix, or does not tell its speed and course.
    """
    told = (gps_raw.fix_type >= FIX_3D) & (gps_raw.vel != _UNKNOWN_U16) & (gps_raw.cog != _UNKNOWN_U16)
    speed = np.where(told, np.asarray(gps_raw.vel) * 0.01, np.nan)
    course = np.radians(np.asarray(gps_raw.cog) * 0.01)
    return _columns(speed * np.cos(course), speed * np.sin(course), np.full_like(speed, np.nan))
