"""Made-up vehicles with known irons, for the calibration tests."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mavcompass.calibration.observation import Dwell, FourPositionData, Step
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, euler_to_matrix, level_to_body, rotate_back, wrap_pi
from mavcompass.heading.compute import level_heading, tilt_compensated_heading
from mavcompass.track import InForce, MagSeries, Series, Track

FIELD = EarthField((232.0, 52.7, -528.9))


@dataclass(frozen=True)
class Iron:
    """raw = offset + gain @ field."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain: FloatArray = field(default_factory=lambda: np.eye(3))

    def raw(self, body_field: FloatArray) -> FloatArray:
        return body_field @ self.gain.T + np.asarray(self.offset)


def iron_of(correction: FieldCorrection) -> Iron:
    """The iron that a correction cures exactly."""
    x, y, z = (-v for v in correction.offsets_mgauss)
    return Iron((x, y, z), np.linalg.inv(correction.matrix))


def body_field(
    psi: FloatArray,
    roll: FloatArray | float = 0.0,
    pitch: FloatArray | float = 0.0,
    earth: EarthField = FIELD,
) -> FloatArray:
    """The Earth's field in body axes at magnetic headings (N,)."""
    h, z = earth.horizontal_mgauss, earth.ned_mgauss[2]
    psi = np.asarray(psi, dtype=float)
    level = np.stack([h * np.cos(psi), -h * np.sin(psi), np.full(psi.shape, z)], axis=-1)
    roll, pitch = np.broadcast_to(roll, psi.shape), np.broadcast_to(pitch, psi.shape)
    return np.einsum("...ij,...j->...i", level_to_body(roll, pitch), level)


def four_positions(
    iron: Iron,
    rng: np.random.Generator | None = None,
    *,
    first: float = 0.4,
    turns: FloatArray | None = None,
    noise: float = 0.0,
    samples: int = 50,
    gyro_sigma: float = 0.0,
    gyro_scale_sigma: float = 1e-9,
    tilt: float = 0.0,
    earth: EarthField = FIELD,
) -> FourPositionData:
    """Dwells at `first` + cumulated `turns` (default three of 90 degrees), as a perfect reader sees them."""
    turns = np.full(3, math.pi / 2) if turns is None else np.asarray(turns)
    psi = first + np.concatenate([[0.0], np.cumsum(turns)])
    rng = rng or np.random.default_rng(0)
    roll, pitch = rng.normal(0, 1, (2, psi.size)) * tilt
    raw = iron.raw(body_field(psi, roll, pitch, earth))
    sd = noise / math.sqrt(samples)
    raw = raw + rng.normal(0, 1, raw.shape) * sd
    dwells = tuple(
        Dwell(
            start_s=10.0 * k,
            end_s=10.0 * k + 5.0,
            mean_mgauss=row,
            covariance_mgauss2=np.eye(3) * max(sd, 1e-4) ** 2,
            roll_rad=float(roll[k]),
            pitch_rad=float(pitch[k]),
            tilt_sigma_rad=1e-6,
            samples=samples,
            turned_rad=float(psi[k] - psi[0]),
        )
        for k, row in enumerate(raw)
    )
    scale = 1.0 + rng.normal() * gyro_scale_sigma
    steps = tuple(
        Step(float(t * scale + rng.normal() * gyro_sigma), max(gyro_sigma, 1e-5), 10.0) for t in turns
    )
    return FourPositionData(dwells, steps, gyro_scale_sigma=gyro_scale_sigma, gyro_bias_sigma_radps=1e-9)


def heading_errors(
    correction: FieldCorrection, iron: Iron, roll: float = 0.0, pitch: float = 0.0, earth: EarthField = FIELD
) -> FloatArray:
    """Heading errors in degrees of a corrected compass at 72 headings."""
    psi = np.arange(72) * (2.0 * math.pi / 72)
    corrected = correction.apply(iron.raw(body_field(psi, roll, pitch, earth)))
    if roll == pitch == 0.0:
        heading = level_heading(corrected)
    else:
        heading = tilt_compensated_heading(
            corrected, roll_rad=np.full(72, roll), pitch_rad=np.full(72, pitch)
        )
    return np.degrees(wrap_pi(heading - psi))


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def turning_track(
    iron: Iron,
    *,
    dwell_s: float = 5.0,
    turn_s: float = 3.0,
    turns_deg: tuple[float, ...] = (90.0, 90.0, 90.0),
    first_deg: float = 25.0,
    noise: float = 1.0,
    gyro_noise: float = 0.002,
    gyro_bias: float = 0.0,
    seed: int = 1,
    whole_numbers: bool = False,
    in_force: FieldCorrection | None = None,
    creep_radps: float = 0.0,
    autopilot: str = "unknown",
) -> Track:
    """A recording of a level vehicle that dwells, turns and dwells, at 50 Hz."""
    rng = np.random.default_rng(seed)
    step = 0.02
    angle = [math.radians(first_deg)]
    for index in range(len(turns_deg) + 1):
        angle += [angle[-1] + creep_radps * step * (i + 1) for i in range(int(dwell_s / step))]
        if index < len(turns_deg):
            n = int(turn_s / step)
            ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, n))
            angle += list(angle[-1] + math.radians(turns_deg[index]) * ramp)
    yaw = np.array(angle)
    time = np.arange(yaw.size) * step
    rate = np.gradient(yaw, time)
    zero = np.zeros(yaw.size)
    rotation = euler_to_matrix(zero, zero, yaw)
    level = rotate_back(
        rotation, np.broadcast_to([FIELD.horizontal_mgauss, 0.0, FIELD.ned_mgauss[2]], (yaw.size, 3))
    )
    raw = iron.raw(level) + rng.normal(0, noise, level.shape)
    correction = in_force or FieldCorrection()
    reported = correction.apply(raw)
    if whole_numbers:
        reported = np.trunc(reported)
    gyro = np.stack([zero, zero, rate], axis=1) + rng.normal(0, gyro_noise, (yaw.size, 3)) + [0, 0, gyro_bias]
    acc = np.tile([0.0, 0.0, -9.80665], (yaw.size, 1)) + rng.normal(0, 0.02, (yaw.size, 3))
    compass = MagSeries(
        1,
        Series.of(time, reported),
        (InForce(-np.inf, correction),),
        quantum_mgauss=1.0 if whole_numbers else 0.0,
        truncated=whole_numbers,
    )
    return Track(
        source="made up",
        autopilot=autopilot,
        vehicle="rover",
        compasses={1: compass},
        acc_mps2=Series.of(time, acc),
        gyro_radps=Series.of(time, gyro),
    )
