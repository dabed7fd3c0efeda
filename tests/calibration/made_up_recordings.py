"""Made-up recordings with all that real ones have: noise that lasts, whole numbers, drift, lag, steel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, euler_to_matrix, euler_to_quaternion, rotate_back
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

EARTH = EarthField((232.0, 52.7, -528.9), sigma_mgauss=(1.3, 0.9, 1.5))
IN_FORCE = FieldCorrection((12.0, -31.0, 8.0), (1.02, 0.97, 1.01), (0.01, -0.02, 0.015))
IRON = FieldCorrection((60.0, -45.0, 25.0), (1.07, 0.94, 1.02), (0.02, -0.01, 0.015))
RATE_HZ = 25.0


def _stop_and_go(seconds: float, stands_s: float, turns_s: float, steps_deg: tuple[float, ...]) -> FloatArray:
    """Make a yaw (N,) that stands and turns on by these steps, in turn."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    yaw, start = np.full(time.size, 0.4), stands_s
    for k in range(math.ceil(seconds / (stands_s + turns_s))):
        part = np.clip((time - start) / turns_s, 0.0, 1.0)
        yaw += math.radians(steps_deg[k % len(steps_deg)]) * (0.5 - 0.5 * np.cos(math.pi * part))
        start += stands_s + turns_s
    return yaw


def _waves(size: int, rng: np.random.Generator, lasts: int) -> FloatArray:
    """Return noise of variance 1, (N, 3), that lasts for so many samples."""
    white = rng.normal(size=(size + lasts - 1, 3))
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(white, axis=0)])
    return np.asarray(total[lasts:] - total[:-lasts]) / math.sqrt(lasts)


def recording(
    vehicle: str,
    yaw: FloatArray,
    roll: FloatArray,
    pitch: FloatArray,
    seed: int,
    autopilot: str = "ardupilot",
    push_mps2: FloatArray | float = 0.0,
    noise_mgauss: float = 3.0,
) -> Track:
    """Record a vehicle: a compass read ten times a second, as whole numbers, whose noise lasts."""
    rng = np.random.default_rng(seed)
    time = 3.0 + np.arange(yaw.size) / RATE_HZ
    rotation = euler_to_matrix(roll, pitch, yaw)
    turn = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    between = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) * RATE_HZ
    rate = np.concatenate([between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]])
    drift = np.radians([0.05, -0.04, 0.06]) + np.radians(0.0004) * (time - 3.0)[:, np.newaxis]
    gyro = rate + drift + 0.003 * rng.normal(size=rate.shape)
    force_ned = np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (time.size, 1))
    force_ned[:, :2] += push_mps2
    force = rotate_back(rotation, force_ned) + 0.04 * rng.normal(size=rate.shape)
    current = 4.0 + 3.0 * (np.arange(time.size) % 400 > 250) + 0.2 * rng.normal(size=time.size)
    level = rotate_back(rotation, np.broadcast_to(EARTH.ned_mgauss, (time.size, 3)))
    motors = np.outer(current, [0.6, -0.4, 0.3])
    raw = IRON.undo(level) + motors + noise_mgauss * _waves(time.size, rng, 3)
    read = (np.floor(np.arange(time.size) / 2.5) * 2.5).astype(int)  # ten times a second, and late
    raw = raw[np.maximum(read - 2, 0)]
    raw[time.size // 2] += 150.0  # a spike
    estimate = np.stack([roll, pitch, yaw], axis=1) + np.radians([0.4, -0.3, 9.0])
    return Track(
        source=f"made-up {vehicle}",
        autopilot=autopilot,
        vehicle=vehicle,
        compasses={
            1: MagSeries(
                1,
                Series.of(time, np.trunc(IN_FORCE.apply(raw))),
                (InForce(-math.inf, IN_FORCE),),
                quantum_mgauss=1.0,
                truncated=True,
            )
        },
        acc_mps2=Series.of(time, np.trunc(force / 0.01) * 0.01),
        gyro_radps=Series.of(time, np.trunc(gyro / 0.001) * 0.001),
        acc_truncation_mps2=0.01,
        gyro_truncation_radps=0.001,
        attitude_rad=Series.of(time[::2], estimate[::2]),
        current_a=Series.of(time, current),
    )


def four_stops(vehicle: str = "rover", sense: float = 1.0, seed: int = 11) -> Track:
    """Stand four times and turn by about 90 degrees between, on ground that is not quite level."""
    yaw = sense * _stop_and_go(29.0, 4.0, 3.0, (88.0, 93.0, 86.0, 95.0))
    still = 0.01 * np.sin(0.9 * np.arange(yaw.size) / RATE_HZ)
    return recording(vehicle, yaw + 0.2 * still, 0.02 + 0.3 * still, -0.03 + 0.0 * still, seed)


def wandering(vehicle: str = "rover", seed: int = 12) -> Track:
    """Go round and round and stop now and then, on slopes."""
    yaw = _stop_and_go(90.0, 2.0, 2.4, (70.0, 50.0, 110.0, -40.0))
    time = np.arange(yaw.size) / RATE_HZ
    roll, pitch = 0.06 * np.sin(0.31 * time + 1.0), 0.05 * np.sin(0.23 * time)
    return recording(vehicle, yaw, roll, pitch, seed)


def hovering(seed: int = 13) -> Track:
    """Sway in the air while it turns; a receiver tells the velocity."""
    yaw = _stop_and_go(46.0, 5.0, 2.5, (90.0, 95.0, 85.0, 90.0))
    time = np.arange(yaw.size) / RATE_HZ
    omega, speed = 1.4, 0.4
    push = speed * omega * np.stack([-np.sin(omega * time), np.cos(omega * time)], axis=1)
    north, east = push.T / STANDARD_GRAVITY_MPS2
    pitch = -(north * np.cos(yaw) + east * np.sin(yaw))
    roll = east * np.cos(yaw) - north * np.sin(yaw)
    track = recording("copter", yaw, roll, pitch, seed, push_mps2=push)
    heard = 3.0 + np.arange(0.2, 46.0, 0.2)
    angle = omega * (heard - 3.0 - 0.11)
    velocity = speed * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    velocity[:, 2] = np.nan
    velocity[:, :2] += 0.05 * np.random.default_rng(seed).normal(size=(heard.size, 2))
    return replace(track, receiver_velocity_mps=Series.of(heard, velocity))


def tumbling(seed: int = 14) -> Track:
    """Turn by hand every way, of no known autopilot."""
    time = np.arange(round(60.0 * RATE_HZ)) / RATE_HZ
    yaw, roll = 0.9 * time, 2.6 * np.sin(0.37 * time)
    return recording("unknown", yaw, roll, 1.2 * np.sin(0.23 * time + 0.5), seed, autopilot="unknown")


def with_reference(track: Track) -> Track:
    """Add an attitude reference that owes nothing to the compass, less the autopilot's own errors."""
    assert track.attitude_rad is not None
    roll, pitch, yaw = (track.attitude_rad.values - np.radians([0.4, -0.3, 9.0])).T
    return replace(
        track, reference_q=Series.of(track.attitude_rad.time_s, euler_to_quaternion(roll, pitch, yaw))
    )


def with_magnet(track: Track, from_s: float, until_s: float) -> Track:
    """Have something magnetic stand beside the vehicle for a while."""
    compass = track.compasses[1]
    beside = (compass.time_s >= from_s) & (compass.time_s < until_s)
    values = compass.reported.values + np.outer(beside, [35.0, -20.0, 12.0])
    return replace(track, compasses={1: replace(compass, reported=Series.of(compass.time_s, values))})


def with_late_gyro(track: Track) -> Track:
    """Have the gyro be recorded neither at the beginning nor at the end."""
    assert track.gyro_radps is not None
    start_s, end_s = track.gyro_radps.time_s[[0, -1]]
    return replace(track, gyro_radps=track.gyro_radps.between(start_s + 1.5, end_s - 1.0))
