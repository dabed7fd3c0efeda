"""How wrong a heading really is: the judgement of what a calibration found on a simulated vehicle."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix, rotate, rotate_back, wrap_pi
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.signals import Signals, Stimulus, ideal
from mavcompass.simulation.vehicle import SimulatedAutopilot

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
    reading is free of noise (that of effects, which may be random, excepted). How the sensors really stand
    and the declination at the place are known exactly: ground that is not level, or a rock in it, is no error
    of a compass.
    """
    yaw = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    raw, stands, field_ned = _held(vehicle, instance, euler_to_matrix(roll_rad, pitch_rad, yaw))
    raw = raw @ vehicle.firmware.compasses.turned(instance).T
    chosen = vehicle.firmware.compasses.held(instance) if correction is None else correction
    field = chosen.apply(raw, vehicle.firmware.compasses.load(chosen))
    # Whatever turns the field about the vertical turns the heading the other way.
    true, found = (np.arctan2(ned[:, 1], ned[:, 0]) for ned in (field_ned, rotate(stands, field)))
    return np.asarray(wrap_pi(true - found), dtype=np.float64)


def heading_error_rms_deg(
    vehicle: SimulatedAutopilot, instance: int = 1, correction: FieldCorrection | None = None
) -> float:
    """Return the rms heading error over the whole circle, degrees; see `heading_errors_rad`."""
    errors = heading_errors_rad(vehicle, instance, correction)
    return float(np.degrees(np.sqrt(np.mean(errors**2))))


def _held(
    vehicle: SimulatedAutopilot, instance: int, rotation: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hold a vehicle in attitudes (N, 3, 3), each long enough for any lag to settle.

    Returns what a compass reads there in the sensor's axes, uncorrected, (N, 3); how its sensors really
    stand, (N, 3, 3); and the Earth's field there, (N, 3).
    """
    field_ned = np.tile(np.asarray(vehicle.world.field_ned_mgauss), (len(rotation), 1))
    raw = vehicle.board.sensors.compasses[instance - 1].model.iron.undo(rotate_back(rotation, field_ned))
    rotation = rotation.copy()
    around, n = vehicle.board.surroundings(), _SETTLING_SAMPLES
    start_s, step_s = vehicle.board.now_us * 1e-6, vehicle.board.tick_us * 1e-6
    if instance != 1 or not vehicle.board.sensors.distortions:
        return raw, rotation, field_ned
    for row, (matrix, reading_mgauss) in enumerate(zip(rotation, raw, strict=True)):
        stimulus = Stimulus.posed(
            start_s + step_s * np.arange(1.0, n + 1.0),
            np.tile(matrix, (n, 1, 1)),
            field_ned[row],
            position_ned_m=np.tile(vehicle.truth.position_ned_m, (n, 1)),
            current_a=np.full(n, around.current_a),
            throttle=np.full(n, around.throttle),
            temperature_degc=np.full(n, around.temperature_degc),
            motors=np.tile(around.motors, (n, 1)),
        )
        reading = replace(ideal(stimulus), mag_mgauss=np.tile(reading_mgauss, (n, 1)))
        signals = Signals(stimulus, reading)
        rng = generator(vehicle.board.seed, f"judge {row}")
        # On copies: what an effect remembers of the journey so far must not change by being looked at.
        for distortion in copy.deepcopy(vehicle.board.sensors.distortions):
            signals = distortion.run(signals, rng)
        raw[row] = signals.reading.mag_mgauss[n // 2 :].mean(axis=0)
        rotation[row], field_ned[row] = (signals.stimulus.rotation[-1], signals.stimulus.field_ned_mgauss[-1])
    return raw, rotation, field_ned
