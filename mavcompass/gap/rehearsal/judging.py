"""How wrong the heading then is, where and as the vehicle is used: level, and leaning by 15 degrees."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix, rotate, rotate_back, wrap_pi
from mavcompass.gap.rehearsal.draws import Individual
from mavcompass.gap.rehearsal.kind import Kind, rows_of
from mavcompass.gap.rehearsal.procedure import FIELD, loads
from mavcompass.simulation.effects.effect import Signals
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.units import STANDARD_GRAVITY_MPS2

TILT_RAD = math.radians(15.0)
_HEADINGS, _LEANINGS = 12, 8
# Each attitude is held until every lag has settled.
_HELD_S, _READINGS = 10.0, 2
_AFTERWARDS_S = 600.0


def _attitudes() -> tuple[FloatArray, FloatArray]:
    """Return yaw (N,) and roll and pitch (N, 2): the circle level first, then leaning in eight directions."""
    lean = np.arange(_LEANINGS) * (2.0 * math.pi / _LEANINGS)
    tilts = np.vstack([np.zeros((1, 2)), TILT_RAD * np.stack([np.cos(lean), np.sin(lean)], axis=1)])
    yaw = np.tile(np.arange(_HEADINGS) * (2.0 * math.pi / _HEADINGS), len(tilts))
    return yaw, np.repeat(tilts, _HEADINGS, axis=0)


_YAW, _TILT = _attitudes()
_ROTATION = euler_to_matrix(_TILT[:, 0], _TILT[:, 1], _YAW)
_LEVELLING = euler_to_matrix(_TILT[:, 0], _TILT[:, 1], 0.0)


def heading_errors_deg(
    kind: Kind, individual: Individual, correction: FieldCorrection, without: Collection[str] = ()
) -> tuple[float, float]:
    """Return the rms heading error over the circle, level and at 15 degrees of tilt in all directions.

    The reading is free of noise, tilt and declination are known exactly; load, temperature and place are
    those of a moment of the recording.
    """
    n = _YAW.size * _READINGS
    field = kind.field_ned_mgauss if FIELD in without else individual.field_ned_mgauss
    rotation = np.repeat(_ROTATION, _READINGS, axis=0)
    force = rotation[:, 2, :] * -STANDARD_GRAVITY_MPS2
    moment = rows_of(kind.used, np.full(n, individual.used))
    stimulus = Stimulus(
        time_s=kind.used.time_s[-1] + _AFTERWARDS_S + _HELD_S * np.arange(n),
        rotation=rotation,
        field_ned_mgauss=np.tile(field, (n, 1)),
        rate_radps=np.zeros((n, 3)),
        specific_force_mps2=force,
        position_ned_m=moment.position_ned_m,
        velocity_ned_mps=np.zeros((n, 3)),
        current_a=moment.current_a,
        throttle=moment.throttle,
        temperature_degc=moment.temperature_degc,
        motors=moment.motors,
    )
    ideal = Reading(rotate_back(rotation, stimulus.field_ned_mgauss), force, np.zeros((n, 3)))
    chain = individual.chain(without, loads(stimulus, kind.in_force))
    raw = chain.run(Signals(stimulus, ideal), None).reading.mag_mgauss[_READINGS - 1 :: _READINGS]
    load = loads(stimulus, correction)[_READINGS - 1 :: _READINGS]
    level = rotate(_LEVELLING, correction.apply(raw, None if correction.motor_source == "none" else load))
    declination = math.atan2(field[1], field[0])
    error = wrap_pi(np.arctan2(-level[:, 1], level[:, 0]) + declination - _YAW)
    square = np.degrees(error) ** 2
    return math.sqrt(float(square[:_HEADINGS].mean())), math.sqrt(float(square[_HEADINGS:].mean()))
