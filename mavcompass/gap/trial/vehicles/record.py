"""Make recordings of a scene: what telemetry kept of it, and what a perfect recorder would have.

The autopilot's attitude is a complementary filter's, bent by whatever steers its yaw: the gyro turns it;
what the accelerometer feels, less the acceleration that the receiver tells, pulls roll and pitch; a
tilt-compensated compass or two antennas pull the yaw; the same pulls, integrated, learn the gyro's bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import euler_to_matrix, euler_to_quaternion, matrix_to_euler, quaternion_to_matrix
from mavcompass.gap.trial.vehicles.draw import Site, Vehicle
from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S, angles
from mavcompass.gap.trial.vehicles.scene import (
    Effect,
    Felt,
    Fixes,
    Scene,
    Stage,
    ambient,
    fixes_of,
    measured_imu,
    readings,
    stream,
)
from mavcompass.track import InForce, MagSeries, Series, Track

_FAST_HZ, _SLOW_HZ = 50.0, 25.0
_LONG_S = 150.0
_YAW_EVERY_S = 0.1
_AGE_S = 0.05
_ANOTHER_NOISE_MGAUSS = 2.0
_ANOTHER_IRON_MGAUSS = 1.5
_ANTENNAS_RAD = math.radians(0.6)


def steer_of(
    scene: Scene, felt: Felt, corrected_mgauss: Array, ambient_mgauss: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return when the yaw is seen, (M,), and how: the field in the body (M, 3), or GPS antennas' yaw (M, 1).

    The field is this compass's corrected readings or another sound compass's. The age of an averaged reading
    is made up for with the gyro, as autopilots do.
    """
    if scene.vehicle.steering == "this_compass":
        every = np.diff(np.floor(scene.reading_s / _YAW_EVERY_S), prepend=-1.0) > 0.0
        time, seen = scene.reading_s[every], corrected_mgauss[every]
        if scene.compass.averaged:
            seen = seen + _AGE_S * np.cross(seen, felt.gyro_radps[(time / STEP_S).astype(np.int64)])
        return time, seen
    time = np.arange(_YAW_EVERY_S, scene.motion.time_s[-1], _YAW_EVERY_S)
    index = (time / STEP_S).astype(np.int64)
    if scene.vehicle.steering == "gps_antennas":
        yaw = angles(scene.motion.rotation[index])[:, 2] + _ANTENNAS_RAD * rng.standard_normal(time.size)
        return time[::2], yaw[::2, None]
    iron = _ANOTHER_IRON_MGAUSS * rng.standard_normal(3)
    noise = _ANOTHER_NOISE_MGAUSS * rng.standard_normal((time.size, 3))
    return time, ambient_mgauss[index] + iron + noise


def attitude_at(
    scene: Scene, felt: Felt, fixes: Fixes, steer: tuple[Array, Array], at_s: Array, rng: np.random.Generator
) -> Array:
    """Run the filter over a scene; return roll, pitch, yaw (T, 3) at times (T,)."""
    rate = _FAST_HZ if scene.motion.time_s[-1] < _LONG_S else _SLOW_HZ
    each = round(1.0 / (rate * STEP_S))
    ticks = (len(felt.gyro_radps) - 1) // each
    gyro = felt.gyro_radps[1 : ticks * each + 1].reshape(ticks, each, 3).mean(axis=1)
    force = felt.acc_mps2[1 : ticks * each + 1].reshape(ticks, each, 3).mean(axis=1)
    time = np.arange(1, ticks + 1) / rate
    told = np.gradient(fixes.velocity_mps, fixes.time_s, axis=0)
    told = np.stack([np.convolve(column, np.ones(3) / 3.0, mode="same") for column in told.T], axis=1)
    pull = np.stack([np.interp(time, fixes.time_s, column) for column in told.T], axis=1)
    measured: list[list[float] | None] = [None] * (ticks + 1)
    for tick, seen in zip(np.searchsorted(time, steer[0]).tolist(), steer[1].tolist(), strict=True):
        measured[tick] = seen
    learnt = scene.vehicle.imu.gyro_bias + np.radians(0.02) * rng.standard_normal(3)
    start = _first_attitude(scene, measured)
    declination = scene.vehicle.site.model.declination_rad
    expected = pull - GRAVITY_NED_MPS2
    track = _filter(scene.vehicle, rate, gyro, force, expected, measured, start, learnt, declination)
    return angles(quaternion_to_matrix(_between(time, track, at_s)))


def _first_attitude(scene: Scene, measured: list[list[float] | None]) -> Array:
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
    measured: list[list[float] | None],
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


_FIX_RATE_HZ = 5.0
_CURRENT_NOISE_A = 0.05
_MILLI_G_MPS2 = 9.80665e-3
_MILLIRAD = 1e-3
_METRES_PER_DEG = 111_195.0


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Hold a track, and the raw readings without noise at its rows, (N, 3), without and with the effects."""

    track: Track
    nominal_mgauss: Array
    changed_mgauss: Array


def record(
    scene: Scene, site: Site, effects: tuple[Effect, ...], lost_share: float, rng: np.random.Generator
) -> Recording:
    """Record a scene with effects; a share of the rows is lost in bursts.

    The generator's draws do not depend on the effects: with and without them a flight is the same.
    """
    noise, imu, receiver, filtering, telemetry = rng.spawn(5)
    vehicle, correction = scene.vehicle, scene.compass.correction
    raw = stream(scene, effects) if effects else scene.plain_mgauss
    loads = _slow_columns(scene, telemetry)
    measured_current = loads["current_a"]
    amperes = measured_current.values[
        np.maximum(np.searchsorted(measured_current.time_s, scene.reading_s, side="right") - 1, 0)
    ]
    noisy = correction.apply(readings(scene, raw, effects, noise), amperes)
    quiet = readings(scene, raw, effects)
    felt = measured_imu(vehicle.imu, scene, imu)
    fixes = fixes_of(scene, vehicle.receiver, _FIX_RATE_HZ, receiver)
    world = ambient(scene, [effect for effect in effects if effect.stage == Stage.WORLD])
    steer = steer_of(scene, felt, noisy, world, filtering)
    attitude = attitude_at(scene, felt, fixes, steer, scene.row_s, filtering)
    keep = _heard(scene.motion.time_s[-1], lost_share, telemetry)
    rows = np.minimum((scene.row_s / STEP_S).astype(np.int64), len(raw) - 1)
    whole = scene.compass.whole
    reported = noisy[scene.held]

    def kept(time_s: Array, values: Array) -> Series:
        there = keep(time_s)
        return Series.of(scene.start_s + time_s[there], values[there])

    gyro, acc = felt.gyro_radps[rows], felt.acc_mps2[rows]
    truth = euler_to_quaternion(*matrix_to_euler(scene.motion.rotation[rows]))
    columns = {name: kept(series.time_s, series.values) for name, series in loads.items()}
    columns |= {name: kept(*column) for name, column in _places(scene, site, fixes).items()}
    track = Track(
        source=f"{vehicle.kind}-{scene.motion.name}",
        autopilot="ardupilot",
        vehicle=vehicle.kind.removeprefix("ackermann-"),
        compasses={1: _compass(scene, kept(scene.row_s, np.trunc(reported) if whole else reported), whole)},
        acc_mps2=kept(scene.row_s, _cut(acc, _MILLI_G_MPS2) if whole else acc),
        gyro_radps=kept(scene.row_s, _cut(gyro, _MILLIRAD) if whole else gyro),
        acc_truncation_mps2=_MILLI_G_MPS2 if whole else 0.0,
        gyro_truncation_radps=_MILLIRAD if whole else 0.0,
        attitude_rad=kept(scene.row_s, attitude),
        truth_q=kept(scene.row_s, truth),
        utc_offset_s=vehicle.utc_s,
        parameters=parameters_of(vehicle),
    )
    track = replace(track, **columns)  # type: ignore[arg-type]
    there = keep(scene.row_s)
    plain = readings(scene, scene.plain_mgauss)
    return Recording(track, plain[scene.held][there], quiet[scene.held][there])


def _index(scene: Scene, time_s: Array) -> np.ndarray:
    return np.minimum((time_s / STEP_S).astype(np.int64), scene.motion.time_s.size - 1)


def _compass(scene: Scene, reported: Series, whole: bool) -> MagSeries:
    return MagSeries(
        instance=1,
        reported=reported,
        in_force=(InForce(-np.inf, scene.compass.correction),),
        quantum_mgauss=1.0 if whole else 0.0,
        truncated=whole,
        device_id=658945,
    )


def _cut(values: Array, step: float) -> Array:
    return np.asarray(np.trunc(values / step) * step)


def _slow_columns(scene: Scene, rng: np.random.Generator) -> dict[str, Series]:
    """Sample the loads as battery, throttle, output and temperature messages do; times from the start."""
    rate, loads = scene.vehicle.slow_rate_hz, scene.loads
    time = np.arange(rng.uniform(0.0, 1.0 / rate), scene.motion.time_s[-1], 1.0 / rate)
    index = _index(scene, time)
    current = loads.current_a[index] + _CURRENT_NOISE_A * rng.standard_normal(time.size)
    warmth = scene.row_s[::2]
    temperature = loads.temperature_degc[_index(scene, warmth)] + 0.03 * rng.standard_normal(warmth.size)
    return {
        "current_a": Series.of(time, np.round(np.maximum(current, 0.0), 2)),
        "throttle": Series.of(time, np.round(loads.throttle[index], 2)),
        "motors": Series.of(time, np.round(loads.motors[index], 3)),
        "temperature_degc": Series.of(warmth, np.round(temperature, 2)),
    }


def _places(scene: Scene, site: Site, fixes: Fixes) -> dict[str, tuple[Array, Array]]:
    """Return the columns of place: a receiver's outdoors, the origin's indoors."""
    at = fixes.position_m
    if scene.vehicle.receiver == "vision":
        once = fixes.time_s[:: round(_FIX_RATE_HZ)]
        origin = np.tile([site.latitude_deg, site.longitude_deg, site.altitude_m], (once.size, 1))
        return {"position_ned_m": (fixes.time_s, at), "place": (once, origin)}
    return {
        "position_ned_m": (fixes.time_s, at),
        "gps_velocity_mps": (fixes.time_s, np.round(fixes.velocity_mps, 2)),
        "place": (fixes.time_s, _degrees(site, at)),
    }


def _degrees(site: Site, position_m: Array) -> Array:
    across = _METRES_PER_DEG * np.cos(np.radians(site.latitude_deg))
    return np.stack(
        [
            np.round(site.latitude_deg + position_m[:, 0] / _METRES_PER_DEG, 7),
            np.round(site.longitude_deg + position_m[:, 1] / across, 7),
            np.round(site.altitude_m - position_m[:, 2], 2),
        ],
        axis=1,
    )


def _heard(length_s: float, lost_share: float, rng: np.random.Generator) -> Callable[[Array], np.ndarray]:
    """Draw bursts of silence that take a share of the time; return which times are heard."""
    bursts = []
    silent = lost_share * length_s
    while silent > 0.0:
        burst = min(float(rng.exponential(0.4)) + 0.05, silent + 0.05)
        bursts.append((float(rng.uniform(0.0, length_s)), burst))
        silent -= burst

    def heard(time_s: Array) -> np.ndarray:
        there = np.ones(time_s.size, dtype=np.bool_)
        for begin, burst in bursts:
            there &= (time_s < begin) | (time_s >= begin + burst)
        return there

    return heard
