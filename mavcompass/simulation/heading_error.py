"""How wrong a heading really is: the judgement of what a calibration found on a simulated vehicle."""

from __future__ import annotations

import copy
import math

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix, rotate, rotate_back, wrap_pi
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.units import STANDARD_GRAVITY_MPS2

# Samples for which an attitude is held when it is judged; the second half is averaged.
_SETTLING_SAMPLES = 100


def heading_errors_rad(
    vehicle: SimulatedAutopilot,
    instance: int = 1,
    correction: FieldCorrection | None = None,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
) -> FloatArray:
    """Return the heading error of a correction (by default the one in force) on the whole circle.

    The vehicle is held at 72 equal steps and a tilt, at its present current and temperature. The
    reading is free of noise (that of effects, which may be random, excepted); the tilt and the
    declination are known exactly.
    """
    yaw = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    rotation = euler_to_matrix(roll_rad, pitch_rad, yaw)
    raw = raw_readings(vehicle, instance, rotation)
    chosen = vehicle.firmware.compasses.held(instance) if correction is None else correction
    load = np.full(yaw.size, vehicle.board.surroundings().current_a)
    field = chosen.apply(raw, load if chosen.motor_source == "current" else None)
    level = rotate(euler_to_matrix(roll_rad, pitch_rad, 0.0), field)
    found = np.arctan2(-level[:, 1], level[:, 0]) + vehicle.world.declination_rad
    return np.asarray(wrap_pi(found - yaw), dtype=np.float64)


def heading_error_rms_deg(
    vehicle: SimulatedAutopilot, instance: int = 1, correction: FieldCorrection | None = None
) -> float:
    """Return the rms heading error over the whole circle, degrees; see `heading_errors_rad`."""
    errors = heading_errors_rad(vehicle, instance, correction)
    return float(np.degrees(np.sqrt(np.mean(errors**2))))


def raw_readings(vehicle: SimulatedAutopilot, instance: int, rotation: FloatArray) -> FloatArray:
    """Return what a compass reads at rest in given attitudes (N, 3, 3): uncorrected, in body axes, (N, 3).

    Those axes are what the parameters make of the sensor's.
    """
    field_ned = np.asarray(vehicle.world.field_ned_mgauss)
    compass = vehicle.board.sensors.compasses[instance - 1]
    raw = compass.model.iron.undo(rotate_back(rotation, field_ned))
    if instance == 1 and vehicle.board.sensors.distortions:
        raw = _distorted(vehicle, rotation, raw)
    return raw @ vehicle.firmware.compasses.turned(instance).T


def _distorted(vehicle: SimulatedAutopilot, rotation: FloatArray, raw: FloatArray) -> FloatArray:
    """Pass readings through the vehicle's effects, each attitude held long enough for any lag to settle."""
    field_ned = np.asarray(vehicle.world.field_ned_mgauss)
    around, n = vehicle.board.surroundings(), _SETTLING_SAMPLES
    start_s, step_s = vehicle.board.now_us * 1e-6, vehicle.board.tick_us * 1e-6
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
        rng = generator(vehicle.board.seed, f"judge {row}")
        # On copies: what an effect remembers of the journey so far must not change by being looked at.
        for distortion in copy.deepcopy(vehicle.board.sensors.distortions):
            reading = distortion.apply(stimulus, reading, rng)
        means[row] = reading.mag_mgauss[n // 2 :].mean(axis=0)
    return means
