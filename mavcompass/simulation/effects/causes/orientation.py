"""The compass mounted in another orientation than the autopilot believes."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import SENSOR_ORIENTATIONS_DEG, FloatArray, rotate_back, sensor_orientation_matrix
from mavcompass.simulation.effects.effect import Effect, Memory, Misfit, Parameter, Rng, Signals, Stage

_FACING = 24


@cache
def _matrix(number: int) -> FloatArray:
    return sensor_orientation_matrix(number) if number in SENSOR_ORIENTATIONS_DEG else np.eye(3)


@cache
def _matrices() -> dict[int, FloatArray]:
    """Return the turn of each number; of several that mean the same turn the first."""
    out: dict[int, FloatArray] = {}
    for number in sorted(SENSOR_ORIENTATIONS_DEG):
        matrix = _matrix(number)
        if not any(np.allclose(matrix, other, atol=1e-9) for other in out.values()):
            out[number] = matrix
    return out


def _forward(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
    # The sensor is turned by R, the autopilot believes it is not: it reports R^T m, the vehicle's iron
    # included.
    return signals.with_mag(signals.reading.mag_mgauss @ _matrix(round(float(theta[0]))))


def _starts(misfit: Misfit) -> list[FloatArray]:
    """Try every orientation; keep the three that fit best."""
    rows = misfit.rows
    predicted = misfit.signals.reading.mag_mgauss[rows]
    measured = predicted + misfit.residual.mag_mgauss[rows]
    facing = _all_around(misfit.signals, rows) if misfit.yaw_unknown else [predicted]
    # |measured - predicted R|^2 depends on R only through trace(R^T predicted^T measured).
    moments = [(one.T @ measured, 0.5 * float(np.sum(one**2))) for one in facing]
    gains = {
        number: max(float(np.sum(matrix * moment)) - own for moment, own in moments)
        for number, matrix in _matrices().items()
    }
    best = sorted(gains, key=gains.__getitem__, reverse=True)
    return [np.array([float(number)]) for number in best[:3] if number != 0]


def _all_around(signals: Signals, rows: NDArray[np.bool_]) -> list[FloatArray]:
    """Return the reading on some rows as the attitude is turned all around; the vehicle's iron stays."""
    s = signals.stimulus
    north, east, down = s.field_ned_mgauss[rows].T
    rotation, reading = s.rotation[rows], signals.reading.mag_mgauss[rows]
    iron = reading - rotate_back(rotation, s.field_ned_mgauss[rows])
    out = []
    for yaw in np.arange(_FACING) * 2.0 * np.pi / _FACING:
        cosine, sine = math.cos(yaw), math.sin(yaw)
        turned = np.stack([cosine * north + sine * east, cosine * east - sine * north, down], axis=1)
        out.append(rotate_back(rotation, turned) + iron)
    return out


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
