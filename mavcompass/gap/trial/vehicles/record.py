"""Make recordings of a scene: what telemetry kept of it, and what a perfect recorder would have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import euler_to_quaternion, matrix_to_euler
from mavcompass.gap.trial.vehicles.autopilot import attitude_at, parameters_of, steer_of
from mavcompass.gap.trial.vehicles.draw import Site
from mavcompass.gap.trial.vehicles.motion import STEP_S
from mavcompass.gap.trial.vehicles.scene import (
    Effect,
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
