"""How things really are: what a simulated result is judged by."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mavcompass.correction import FieldCorrection, Vector
from mavcompass.frames import FloatArray, euler_to_matrix, rotate, rotate_back, wrap_pi
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from mavcompass.simulation.vehicle import SimulatedAutopilot

# Samples for which an attitude is held when it is judged; the second half is averaged.
_SETTLING_SAMPLES = 100


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Hold the true state at one moment.

    Attributes:
        rotation: body to NED, (3, 3); roll_rad, pitch_rad, yaw_rad: the same as angles.
        position_ned_m: relative to the start; field_ned_mgauss: the Earth's field there.
    """

    time_s: float
    rotation: FloatArray
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float
    position_ned_m: Vector
    velocity_ned_mps: Vector
    field_ned_mgauss: Vector
    declination_rad: float
    current_a: float
    temperature_degc: float


def truth_of(vehicle: SimulatedAutopilot) -> Truth:
    """Read the true state off a simulated vehicle."""
    body, around = vehicle.body, vehicle.surroundings()
    return Truth(
        time_s=vehicle.now_us * 1e-6,
        rotation=np.array(body.rotation).reshape(3, 3),
        roll_rad=body.roll_rad,
        pitch_rad=body.pitch_rad,
        yaw_rad=body.yaw_rad,
        yaw_rate_radps=body.yaw_rate_radps,
        position_ned_m=(body.north_m, body.east_m, -body.height_m),
        velocity_ned_mps=body.velocity_ned_mps,
        field_ned_mgauss=vehicle.world.field_ned_mgauss,
        declination_rad=vehicle.world.declination_rad,
        current_a=around.current_a,
        temperature_degc=around.temperature_degc,
    )


def true_correction(vehicle: SimulatedAutopilot, instance: int = 1) -> FieldCorrection:
    """Return the exact cure of a compass's iron (further effects are not in it)."""
    return vehicle.sensors.compasses[instance - 1].model.iron


def heading_errors_rad(
    vehicle: SimulatedAutopilot,
    instance: int = 1,
    correction: FieldCorrection | None = None,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    headings: int = 72,
) -> FloatArray:
    """Return the heading error of a correction (by default the one in force) on the whole circle.

    The vehicle is held at `headings` equal steps and a tilt, at its present current and temperature. The
    reading is free of noise (that of effects, which may be random, excepted); the tilt and the
    declination are known exactly.
    """
    yaw = np.linspace(-math.pi, math.pi, headings, endpoint=False)
    rotation = euler_to_matrix(roll_rad, pitch_rad, yaw)
    raw = raw_readings(vehicle, instance, rotation)
    chosen = vehicle.firmware.correction(instance) if correction is None else correction
    load = np.full(headings, vehicle.surroundings().current_a)
    field = chosen.apply(raw, load if chosen.motor_source == "current" else None)
    level = rotate(euler_to_matrix(roll_rad, pitch_rad, 0.0), field)
    found = np.arctan2(-level[:, 1], level[:, 0]) + vehicle.world.declination_rad
    return np.asarray(wrap_pi(found - yaw), dtype=np.float64)


def heading_error_rms_deg(
    vehicle: SimulatedAutopilot,
    instance: int = 1,
    correction: FieldCorrection | None = None,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
) -> float:
    """Return the rms heading error over the whole circle, degrees; see `heading_errors_rad`."""
    errors = heading_errors_rad(vehicle, instance, correction, roll_rad, pitch_rad)
    return float(np.degrees(np.sqrt(np.mean(errors**2))))


def raw_readings(vehicle: SimulatedAutopilot, instance: int, rotation: FloatArray) -> FloatArray:
    """Return what a compass reads, uncorrected, at rest in given attitudes (N, 3, 3); shape (N, 3)."""
    field_ned = np.asarray(vehicle.world.field_ned_mgauss)
    compass = vehicle.sensors.compasses[instance - 1]
    raw = compass.model.iron.undo(rotate_back(rotation, field_ned))
    if instance != 1 or not vehicle.sensors.distortions:
        return raw
    return _distorted(vehicle, rotation, raw)


def _distorted(vehicle: SimulatedAutopilot, rotation: FloatArray, raw: FloatArray) -> FloatArray:
    """Pass readings through the vehicle's effects, each attitude held long enough for any lag to settle."""
    field_ned = np.asarray(vehicle.world.field_ned_mgauss)
    around, n = vehicle.surroundings(), _SETTLING_SAMPLES
    start_s, step_s = vehicle.now_us * 1e-6, vehicle.tick_us * 1e-6
    means = np.empty_like(raw)
    for row, (matrix, reading_mgauss) in enumerate(zip(rotation, raw, strict=True)):
        force = np.tile(matrix.T @ [0.0, 0.0, -STANDARD_GRAVITY_MPS2], (n, 1))
        stimulus = Stimulus(
            time_s=start_s + step_s * np.arange(1.0, n + 1.0),
            rotation=np.tile(matrix, (n, 1, 1)),
            field_ned_mgauss=np.tile(field_ned, (n, 1)),
            rate_radps=np.zeros((n, 3)),
            specific_force_mps2=force,
            position_ned_m=np.tile(vehicle.truth.position_ned_m, (n, 1)),
            velocity_ned_mps=np.zeros((n, 3)),
            current_a=np.full(n, around.current_a),
            throttle=np.full(n, around.throttle),
            temperature_degc=np.full(n, around.temperature_degc),
            motors=np.tile(around.motors, (n, 1)),
        )
        reading = Reading(np.tile(reading_mgauss, (n, 1)), force, np.zeros((n, 3)))
        rng = generator(vehicle.seed, f"judge {row}")
        # On copies: what an effect remembers of the journey so far must not change by being looked at.
        for distortion in copy.deepcopy(vehicle.sensors.distortions):
            reading = distortion.apply(stimulus, reading, rng)
        means[row] = reading.mag_mgauss[n // 2 :].mean(axis=0)
    return means
