"""The autopilot: its attitude filter, bent by whatever steers its yaw, and its parameters.

A complementary filter: the gyro turns the attitude; what the accelerometer feels, less the acceleration
that the receiver tells, pulls roll and pitch; a tilt-compensated compass or two antennas pull the yaw; the
same pulls, integrated, learn the gyro's bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import euler_to_matrix, euler_to_quaternion, quaternion_to_matrix
from mavcompass.gap.trial.vehicles.draw import Vehicle
from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S, angles
from mavcompass.gap.trial.vehicles.scene import Felt, Fixes, Scene

_FAST_HZ, _SLOW_HZ = 50.0, 25.0
_LONG_S = 150.0
_YAW_EVERY_S = 0.1
_AGE_S = 0.05
_ANOTHER_NOISE_MGAUSS = 2.0
_ANOTHER_IRON_MGAUSS = 1.5
_ANTENNAS_RAD = math.radians(0.6)


@dataclass(frozen=True, slots=True, eq=False)
class Steer:
    """Hold what the yaw follows: times (M,), and either body fields (M, 3) or yaw angles (M,)."""

    time_s: Array
    field_mgauss: Array | None
    yaw_rad: Array | None


def steer_of(
    scene: Scene, felt: Felt, corrected_mgauss: Array, ambient_mgauss: Array, rng: np.random.Generator
) -> Steer:
    """Return what steers: this compass's corrected readings, another sound compass, or GPS antennas.

    The age of an averaged reading is made up for with the gyro, as autopilots do.
    """
    if scene.vehicle.steering == "this_compass":
        every = np.diff(np.floor(scene.reading_s / _YAW_EVERY_S), prepend=-1.0) > 0.0
        time, seen = scene.reading_s[every], corrected_mgauss[every]
        if scene.compass.averaged:
            seen = seen + _AGE_S * np.cross(seen, felt.gyro_radps[(time / STEP_S).astype(np.int64)])
        return Steer(time, seen, None)
    time = np.arange(_YAW_EVERY_S, scene.motion.time_s[-1], _YAW_EVERY_S)
    index = (time / STEP_S).astype(np.int64)
    if scene.vehicle.steering == "gps_antennas":
        yaw = angles(scene.motion.rotation[index])[:, 2] + _ANTENNAS_RAD * rng.standard_normal(time.size)
        return Steer(time[::2], None, yaw[::2])
    iron = _ANOTHER_IRON_MGAUSS * rng.standard_normal(3)
    return Steer(
        time, ambient_mgauss[index] + iron + _ANOTHER_NOISE_MGAUSS * rng.standard_normal((time.size, 3)), None
    )


def attitude_at(
    scene: Scene, felt: Felt, fixes: Fixes | None, steer: Steer, time_s: Array, rng: np.random.Generator
) -> Array:
    """Run the filter over a scene; return roll, pitch, yaw (T, 3) at times (T,)."""
    rate = _FAST_HZ if scene.motion.time_s[-1] < _LONG_S else _SLOW_HZ
    each = round(1.0 / (rate * STEP_S))
    ticks = (len(felt.gyro_radps) - 1) // each
    gyro = felt.gyro_radps[1 : ticks * each + 1].reshape(ticks, each, 3).mean(axis=1)
    force = felt.acc_mps2[1 : ticks * each + 1].reshape(ticks, each, 3).mean(axis=1)
    time = np.arange(1, ticks + 1) / rate
    pull = np.zeros((ticks, 3))
    if fixes is not None:
        told = np.gradient(fixes.velocity_mps, fixes.time_s, axis=0)
        told = np.stack([np.convolve(column, np.ones(3) / 3.0, mode="same") for column in told.T], axis=1)
        pull = np.stack([np.interp(time, fixes.time_s, column) for column in told.T], axis=1)
    first = np.maximum(np.searchsorted(time, steer.time_s), 0)
    measured: list[tuple[float, float, float] | None] = [None] * (ticks + 1)
    if steer.field_mgauss is not None:
        for tick, (x, y, z) in zip(first.tolist(), steer.field_mgauss.tolist(), strict=True):
            measured[tick] = (x, y, z)
    elif steer.yaw_rad is not None:
        for tick, angle in zip(first.tolist(), steer.yaw_rad.tolist(), strict=True):
            measured[tick] = (angle, 0.0, 0.0)
    learnt = scene.vehicle.imu.gyro_bias + np.radians(0.02) * rng.standard_normal(3)
    start = _first_attitude(scene, measured)
    declination = scene.vehicle.site.model.declination_rad
    expected = pull - GRAVITY_NED_MPS2
    track = _filter(scene.vehicle, rate, gyro, force, expected, measured, start, learnt, declination)
    return angles(quaternion_to_matrix(_between(time, track, time_s)))


def _first_attitude(scene: Scene, measured: list[tuple[float, float, float] | None]) -> Array:
    """Start at the true tilt and at the yaw that the steering sensor gives."""
    tilt = angles(scene.motion.rotation[:1])
    flat = euler_to_matrix(tilt[0, 0], tilt[0, 1], 0.0)
    first = next(item for item in measured if item is not None)
    if scene.vehicle.steering == "gps_antennas":
        yaw = first[0]
    else:
        north, east, _ = flat @ np.array(first)
        yaw = scene.vehicle.site.model.declination_rad - math.atan2(east, north)
    return euler_to_quaternion(tilt[0, 0], tilt[0, 1], yaw)


def _filter(
    vehicle: Vehicle,
    rate_hz: float,
    gyro: Array,
    force: Array,
    expected: Array,
    measured: list[tuple[float, float, float] | None],
    start: Array,
    learnt: Array,
    declination: float,
) -> Array:
    """Step through the ticks with plain numbers; return quaternions (T, 4)."""
    step = 1.0 / rate_hz
    tilt_gain = step / vehicle.tilt_seconds
    yaw_gain = _YAW_EVERY_S / vehicle.yaw_seconds * (2.0 if vehicle.steering == "gps_antennas" else 1.0)
    tilt_learning, yaw_learning = tilt_gain / 60.0, yaw_gain / 90.0
    antennas = vehicle.steering == "gps_antennas"
    w, x, y, z = start.tolist()
    bx, by, bz = learnt.tolist()
    out = []
    for (gx, gy, gz), (fx, fy, fz), (en, ee, ed), seen in zip(
        gyro.tolist(), force.tolist(), expected.tolist(), measured, strict=False
    ):
        # Half of the turned angle, and of the pulls, in body axes.
        hx, hy, hz = 0.5 * step * (gx - bx), 0.5 * step * (gy - by), 0.5 * step * (gz - bz)
        w, x, y, z = (
            w - x * hx - y * hy - z * hz,
            x + w * hx + y * hz - z * hy,
            y + w * hy + z * hx - x * hz,
            z + w * hz + x * hy - y * hx,
        )
        cxx, cxy, cxz = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        cyx, cyy, cyz = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        czx, czy, czz = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        # The force that this attitude would feel, against the one that is felt.
        px, py, pz = (
            cxx * en + cyx * ee + czx * ed,
            cxy * en + cyy * ee + czy * ed,
            cxz * en + cyz * ee + czz * ed,
        )
        size = math.sqrt((px * px + py * py + pz * pz) * (fx * fx + fy * fy + fz * fz))
        tx, ty, tz = (fy * pz - fz * py) / size, (fz * px - fx * pz) / size, (fx * py - fy * px) / size
        yaw_error = 0.0
        if seen is not None:
            if antennas:
                yaw_error = seen[0] - math.atan2(cyx, cxx)
            else:
                mx, my, mz = seen
                north = cxx * mx + cxy * my + cxz * mz
                east = cyx * mx + cyy * my + cyz * mz
                yaw_error = declination - math.atan2(east, north)
            yaw_error = math.remainder(yaw_error, 2.0 * math.pi)
        pull = yaw_gain * yaw_error
        sx, sy, sz = tilt_gain * tx + pull * czx, tilt_gain * ty + pull * czy, tilt_gain * tz + pull * czz
        learn = yaw_learning * yaw_error
        bx -= tilt_learning * tx + learn * czx
        by -= tilt_learning * ty + learn * czy
        bz -= tilt_learning * tz + learn * czz
        hx, hy, hz = 0.5 * sx, 0.5 * sy, 0.5 * sz
        w, x, y, z = (
            w - x * hx - y * hy - z * hz,
            x + w * hx + y * hz - z * hy,
            y + w * hy + z * hx - x * hz,
            z + w * hz + x * hy - y * hx,
        )
        norm = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * norm, x * norm, y * norm, z * norm
        out.append((w, x, y, z))
    return np.array(out)


def _between(time: Array, track: Array, wanted: Array) -> Array:
    """Interpolate quaternions (T, 4) that vary little from one to the next."""
    turned = np.einsum("ni,ni->n", track[1:], track[:-1]) < 0.0
    signs = np.where(np.concatenate([[0], np.cumsum(turned)]) % 2 == 1, -1.0, 1.0)
    even = track * signs[:, None]
    at = np.stack([np.interp(wanted, time, column) for column in even.T], axis=1)
    return np.asarray(at / np.linalg.norm(at, axis=1, keepdims=True))


def parameters_of(vehicle: Vehicle) -> dict[str, float]:
    """List the autopilot's parameters as a recording holds them."""
    correction = vehicle.compass.correction
    named = {
        **dict(zip((f"COMPASS_OFS_{a}" for a in "XYZ"), correction.offsets_mgauss, strict=True)),
        **dict(zip((f"COMPASS_DIA_{a}" for a in "XYZ"), correction.diagonals, strict=True)),
        **dict(zip((f"COMPASS_ODI_{a}" for a in "XYZ"), correction.off_diagonals, strict=True)),
        **dict(zip((f"COMPASS_MOT_{a}" for a in "XYZ"), correction.motor_mgauss, strict=True)),
    }
    this, another = vehicle.steering == "this_compass", vehicle.steering == "another_compass"
    return named | {
        "COMPASS_ENABLE": 1.0,
        "COMPASS_SCALE": correction.scale,
        "COMPASS_MOTCT": 2.0 if correction.motor_source == "current" else 0.0,
        "COMPASS_ORIENT": 0.0,
        "COMPASS_EXTERNAL": 1.0,
        "COMPASS_AUTODEC": 1.0,
        "COMPASS_DEC": vehicle.site.model.declination_rad,
        "COMPASS_USE": float(this),
        "COMPASS_USE2": float(another),
        "COMPASS_USE3": 0.0,
        "AHRS_EKF_TYPE": 3.0,
        "EK3_ENABLE": 1.0,
        "EK3_SRC1_YAW": 2.0 if vehicle.steering == "gps_antennas" else 1.0,
    }
