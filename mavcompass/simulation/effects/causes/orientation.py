"""The compass mounted in another orientation than the autopilot believes."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from mavcompass.frames import SENSOR_ORIENTATIONS_DEG, FloatArray, rotate_back, sensor_orientation_matrix
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage


@cache
def _matrices() -> dict[int, FloatArray]:
    return {number: sensor_orientation_matrix(number) for number in SENSOR_ORIENTATIONS_DEG}


def _forward(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    # The sensor is turned by R, the autopilot believes it is not: it reports R^T m, the vehicle's iron
    # included.
    matrix = _matrices().get(round(float(theta[0])), np.eye(3))
    return signals.with_mag(signals.reading.mag_mgauss @ matrix)


def _starts(misfit: Misfit) -> list[FloatArray]:
    """Try every orientation; keep the three that fit best."""
    rows = misfit.rows
    predicted = misfit.signals.reading.mag_mgauss[rows]
    measured = predicted + misfit.residual.mag_mgauss[rows]
    # |measured - predicted R|^2 depends on R only through trace(R^T predicted^T measured).
    if misfit.yaw_unknown:
        parts = [part[rows].T @ measured for part in _by_yaw(misfit.signals)]
        gains = {
            number: float(np.sum(matrix * parts[0]))
            + math.hypot(float(np.sum(matrix * parts[1])), float(np.sum(matrix * parts[2])))
            for number, matrix in _matrices().items()
        }
    else:
        moment = predicted.T @ measured
        gains = {number: float(np.sum(matrix * moment)) for number, matrix in _matrices().items()}
    best = sorted(gains, key=gains.__getitem__, reverse=True)
    return [np.array([float(number)]) for number in best[:3] if number != 0]


def _by_yaw(signals: Signals) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the field in the body's axes as parts a + b cos(yaw) + c sin(yaw) of a turn of the attitude."""
    s = signals.stimulus
    north, east, down = s.field_ned_mgauss.T
    zero = np.zeros_like(north)
    fields = ((zero, zero, down), (north, east, zero), (east, -north, zero))
    a, b, c = (rotate_back(s.rotation, np.stack(field, axis=1)) for field in fields)
    return a, b, c


EFFECTS = (
    Effect(
        id="orientation",
        title="the compass is mounted in another orientation",
        stage=Stage.MOUNTING,
        parameters=(Parameter("orientation", "MAV_SENSOR_ORIENTATION", 0.0, 43.0, 2.0, 1.0, integer=True),),
        forward=_forward,
        kind="discrete",
        aliases=("misalignment",),
        separated_by="any turn; tilt where the mounting differs by a rotation about the vertical",
        source="MAVLink MAV_SENSOR_ORIENTATION; raw = R^T m",
        starts=_starts,
        sitl=lambda values: {"SIM_MAG1_ORIENT": float(round(values["orientation"]))},
    ),
)
