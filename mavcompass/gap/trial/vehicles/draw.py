"""Draw a vehicle: its place, iron, calibration, sensors and who steers its attitude filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, decimal_year, earth_field
from mavcompass.frames import FloatArray as Array
from mavcompass.frames import rotvec_to_matrix

Cure = Literal["exact", "two_percent", "old"]
Steering = Literal["this_compass", "another_compass", "gps_antennas"]
Receiver = Literal["gps", "rtk", "vision"]

KINDS = ("rover", "ackermann-rover", "boat", "copter")
RATES_HZ = (10.0, 12.5, 20.0, 25.0, 40.0, 50.0)
# Below this horizontal field no autopilot is steered by a compass.
_WEAKEST_LEVEL_MGAUSS = 90.0
_ANOMALY = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Hold a place: degrees, metres, the model's field and the true one (3,), NED, milligauss."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    model: EarthField
    field_mgauss: Array


@dataclass(frozen=True, slots=True, eq=False)
class Compass:
    """Hold what is true of the compass under test.

    raw = matrix @ (field in the body) + iron + current_field * current, all in milligauss; readings carry
    white noise of `noise_mgauss` and slow noise of `slow_noise_mgauss`. `averaged`: the autopilot reads the
    mean of the last 100 ms ten times a second and repeats it. `whole`: sent as int16, cut toward zero.
    """

    iron_mgauss: Array
    matrix: Array
    current_field: Array
    correction: FieldCorrection
    noise_mgauss: Array
    slow_noise_mgauss: float
    averaged: bool
    whole: bool


@dataclass(frozen=True, slots=True, eq=False)
class Imu:
    """Hold the errors of gyro (rad/s) and accelerometer (m/s^2); noises are per sample at 100 Hz."""

    gyro_bias: Array
    gyro_scale: Array
    gyro_noise: float
    gyro_walk: float
    acc_bias: Array
    acc_noise: float
    acc_vibration: float


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """Hold a vehicle that both the baseline and the flight are recorded with."""

    kind: str
    site: Site
    utc_s: float
    compass: Compass
    imu: Imu
    cure: Cure
    steering: Steering
    receiver: Receiver
    rate_hz: float
    slow_rate_hz: float
    tilt_seconds: float
    yaw_seconds: float


def draw_vehicle(rng: np.random.Generator, kind: str, averaged: bool | None, precise: bool) -> Vehicle:
    """Draw a vehicle; `averaged` fixes how its compass is read, `precise` asks for good positions."""
    utc = 1_735_700_000.0 + rng.uniform(0.2, 2.0) * 3.15576e7
    site = draw_site(rng, utc)
    cures: tuple[Cure, ...] = ("exact", "two_percent", "old")
    cure = cures[rng.choice(3, p=[0.4, 0.35, 0.25])]
    another: Steering = "another_compass"
    others: list[Steering] = [another, another, another, "gps_antennas"]
    indoors = kind in ("rover", "copter") and rng.random() < 0.15
    others = others[:1] if indoors else others
    steering: Steering = "this_compass" if rng.random() < 2.0 / 3.0 else others[rng.integers(len(others))]
    receiver: Receiver = (
        "vision" if indoors else "rtk" if rng.random() < (0.75 if precise else 0.4) else "gps"
    )
    return Vehicle(
        kind=kind,
        site=site,
        utc_s=utc,
        compass=_compass(
            rng, cure, rng.random() < 0.4 if averaged is None else averaged, site.model.horizontal_mgauss
        ),
        imu=_imu(rng, kind),
        cure=cure,
        steering=steering,
        receiver=receiver,
        rate_hz=float(rng.choice(RATES_HZ)),
        slow_rate_hz=float(rng.choice([5.0, 10.0])),
        tilt_seconds=float(np.exp(rng.uniform(np.log(2.0), np.log(6.0)))),
        yaw_seconds=float(np.exp(rng.uniform(np.log(1.5), np.log(8.0)))),
    )


def draw_site(rng: np.random.Generator, utc_s: float, near: Site | None = None) -> Site:
    """Draw a place on Earth with an anomaly of about 1 % of its own, or one 1 to 50 km from another."""
    while True:
        latitude = float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0) * np.sin(np.radians(64.5)))))
        longitude, altitude = float(rng.uniform(-180.0, 180.0)), float(rng.uniform(0.0, 900.0))
        if near is not None:
            away = np.exp(rng.uniform(np.log(1e3), np.log(5e4))) / 111_195.0
            toward = rng.uniform(0.0, 2.0 * np.pi)
            latitude = near.latitude_deg + float(away * np.cos(toward))
            longitude = near.longitude_deg + float(away * np.sin(toward) / np.cos(np.radians(latitude)))
            altitude = near.altitude_m
        model = earth_field(latitude, longitude, altitude, decimal_year(utc_s))
        if model.horizontal_mgauss > _WEAKEST_LEVEL_MGAUSS or near is not None:
            break
    anomaly = _ANOMALY * model.total_mgauss / np.sqrt(3.0) * rng.standard_normal(3)
    return Site(latitude, longitude, altitude, model, model.vector_mgauss + anomaly)


def unit(rng: np.random.Generator, count: int = 3) -> Array:
    """Draw a direction (count,)."""
    vector = rng.standard_normal(count)
    return np.asarray(vector / np.linalg.norm(vector))


def _metal(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw iron (3,) and the matrix (3, 3) of gains, oblique axes and soft iron."""
    iron = np.exp(rng.uniform(np.log(50.0), np.log(400.0))) * unit(rng)
    gains = np.diag(1.0 + rng.uniform(-0.15, 0.15, 3))
    lean = np.radians(rng.uniform(-5.0, 5.0, 3))
    oblique = np.array(
        [[1.0, 0.0, 0.0], [np.sin(lean[0]), 1.0, 0.0], [np.sin(lean[1]), np.sin(lean[2]), 1.0]]
    )
    oblique /= np.linalg.norm(oblique, axis=1, keepdims=True)
    soft = rng.uniform(0.0, 0.03) * rng.standard_normal((3, 3))
    return iron, gains @ oblique @ (np.eye(3) + 0.5 * (soft + soft.T))


def _symmetric_part(matrix: Array) -> Array:
    """Take the turn out of a matrix: the symmetric factor S of matrix = turn @ S (3, 3)."""
    _, stretches, axes = np.linalg.svd(matrix)
    return np.asarray(axes.T @ np.diag(stretches) @ axes)


def _compass(rng: np.random.Generator, cure: Cure, averaged: bool, level_mgauss: float) -> Compass:
    iron, matrix = _metal(rng)
    current_field = rng.uniform(0.1, 0.6) * unit(rng) if rng.random() < 0.2 else np.zeros(3)
    turn = np.eye(3)
    if cure != "old":
        # Neither autopilot's calibration holds a turn: it was mounted so that none is left.
        matrix = _symmetric_part(matrix)
    believed_iron, believed = iron, _symmetric_part(matrix)
    believed_current = current_field
    if cure == "old":
        turn = rotvec_to_matrix(np.radians(rng.normal(0.0, 0.7, 3)))
        # More than half of the level field, and the vehicle would not have left the ground.
        most = min(200.0, 0.5 * level_mgauss)
        change = np.exp(rng.uniform(np.log(30.0), np.log(most))) * unit(rng)
        believed_iron = iron + change
        believed = believed + 0.03 * _symmetric_noise(rng)
        believed_current = current_field * rng.uniform(0.0, 1.5)
    offsets, correcting = -believed_iron, np.linalg.inv(believed)
    motor = -correcting @ believed_current
    if cure == "two_percent":
        offsets = offsets * (1.0 + _about_two_percent(rng, 3))
        off = _about_two_percent(rng, 9).reshape(3, 3)
        correcting = np.eye(3) + (correcting - np.eye(3)) * (1.0 + np.triu(off) + np.triu(off, 1).T)
        motor = motor * (1.0 + _about_two_percent(rng, 3))
    return Compass(
        iron_mgauss=iron,
        matrix=turn @ matrix,
        current_field=current_field,
        correction=FieldCorrection.from_matrix(
            offsets, correcting, motor_mgauss=motor, motor_source="current" if motor.any() else "none"
        ),
        noise_mgauss=rng.uniform(1.0, 4.0) * np.array([1.0, 1.0, rng.uniform(1.0, 1.3)]),
        slow_noise_mgauss=float(rng.uniform(0.2, 0.7)),
        averaged=averaged,
        whole=bool(rng.random() < 0.5),
    )


def _about_two_percent(rng: np.random.Generator, count: int) -> Array:
    return 0.02 * rng.choice([-1.0, 1.0], count) * rng.uniform(0.6, 1.4, count)


def _symmetric_noise(rng: np.random.Generator) -> Array:
    noise = rng.standard_normal((3, 3))
    return np.asarray(0.5 * (noise + noise.T))


def _imu(rng: np.random.Generator, kind: str) -> Imu:
    density = np.radians(np.exp(rng.uniform(np.log(0.004), np.log(0.015))))
    vibration = {"copter": 0.7, "boat": 0.15}.get(kind, 0.3) * np.exp(rng.uniform(-0.7, 0.7))
    return Imu(
        gyro_bias=np.radians(rng.uniform(0.0, 0.3)) * unit(rng),
        gyro_scale=rng.uniform(0.0, 0.008) * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.3, 1.0, 3),
        gyro_noise=float(density * np.sqrt(50.0)),
        gyro_walk=float(np.radians(np.exp(rng.uniform(np.log(0.0003), np.log(0.003))))),
        acc_bias=rng.uniform(0.0, 0.15) * unit(rng),
        acc_noise=float(rng.uniform(0.01, 0.04)),
        acc_vibration=float(vibration),
    )
