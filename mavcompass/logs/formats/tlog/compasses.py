"""Which MAVLink message speaks for which compass, and what its numbers are in milligauss and body axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mavcompass.compass_parameters import ardupilot_name, px4_name, px4_sensor_to_body
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.logs.common import Change, ardupilot_steps, finite_series, px4_steps, said_nothing, spoken
from mavcompass.logs.formats.tlog.clock import Samples
from mavcompass.messages import telemetry
from mavcompass.track import InForce, MagSeries
from mavcompass.units import MGAUSS_PER_GAUSS

HIGHRES = "HIGHRES_IMU"
# ArduPilot sent HIGHRES_IMU's field a million times too large until 2026; Earth's is below one gauss.
_NO_FIELD_GAUSS = 1000.0
_ARDUPILOT_HIGHRES_PER_MGAUSS = 1000.0
_DENSER, _DENSER_PX4 = 2, 10
_LESS_LEARNT = (
    "PX4's HIGHRES_IMU is less the bias that its estimator learns in flight, which it does not tell: iron may"
    " be hidden by it. Record SCALED_IMU too, with the parameters, or give the autopilot's own log (.ulg)."
)


def spokesmen(count: Callable[[str], int], autopilot: str, rotation_known: bool) -> dict[int, str]:
    """Choose the message for each compass, by instance; `count` tells how many messages of a name there are.

    Compass 1 speaks in up to three messages. Of RAW_IMU and SCALED_IMU the denser is taken. HIGHRES_IMU
    steps in where it is more than twice as dense. On PX4 it holds what the estimator leaves of the iron:
    there it steps in only where SCALED_IMU is too seldom to follow a turn, or its axes are not known.
    """
    chosen: dict[int, str] = {}
    for name, instance in telemetry.MAG_MESSAGES.items():
        if count(name) > (count(chosen[instance]) if instance in chosen else 0):
            chosen[instance] = name
    blind = autopilot == "px4" and not rotation_known
    times = _DENSER_PX4 if autopilot == "px4" else _DENSER
    if count(HIGHRES) and (1 not in chosen or blind or count(HIGHRES) > times * count(chosen[1])):
        chosen[1] = HIGHRES
    return dict(sorted(chosen.items()))


def compass_of(
    instance: int,
    samples: Samples,
    autopilot: str,
    history: Sequence[Change],
    parameters: Mapping[str, float],
) -> tuple[MagSeries | None, tuple[str, ...]]:
    """Build one compass's readings with the corrections inside them, and notes on what was supposed.

    None where the message carries no magnetic field.
    """
    notes: list[str] = []
    highres = samples.name == HIGHRES
    reported = _highres_mgauss(samples.rows, autopilot) if highres else telemetry.field_mgauss(samples.rows)
    steps: tuple[InForce, ...] = (InForce(-np.inf, IDENTITY),)
    known = True
    device_id: float | None = None
    not_applied: FieldCorrection | None = None
    if autopilot == "ardupilot":
        steps, known = ardupilot_steps(history, instance)
        device_id = parameters.get(ardupilot_name("DEV_ID", instance))
    elif autopilot == "px4":
        device_id = parameters.get(px4_name("ID", instance))
        in_force, in_force_known = px4_steps(history, instance)
        if highres:
            steps, known = in_force, in_force_known
            notes.append(_LESS_LEARNT)
        else:
            not_applied = in_force[-1].correction if in_force_known else None
            reported, more = _px4_body_axes(reported, parameters, instance)
            notes += more
    else:
        known = False
    series, silent = spoken(finite_series(samples.time_s, reported))
    if series is None:
        return None, (f"{samples.name} carries no magnetic field: there is no compass {instance}.",)
    notes += said_nothing(instance, silent, series)
    compass = MagSeries(
        instance=instance,
        reported=series,
        in_force=steps,
        correction_known=known,
        quantum_mgauss=0.0 if highres else 1.0,
        truncated=not highres,
        device_id=None if device_id is None else int(device_id),
        not_applied=not_applied,
        less_learnt=highres and autopilot == "px4",
    )
    return compass, tuple(notes)


def _px4_body_axes(
    sensor_mgauss: FloatArray, parameters: Mapping[str, float], instance: int
) -> tuple[FloatArray, tuple[str, ...]]:
    """Turn PX4's SCALED_IMU, uncorrected and in the sensor's axes, into body axes."""
    name = px4_name("ROT", instance)
    if name not in parameters:
        return sensor_mgauss, (f"{name} is not recorded: compass {instance} is taken as not rotated.",)
    return sensor_mgauss @ px4_sensor_to_body(parameters, instance).T, ()


def _highres_mgauss(rows: object, autopilot: str) -> FloatArray:
    field = telemetry.field_mgauss(rows).astype(np.float64)
    if autopilot == "ardupilot" and float(np.median(np.abs(field).max(axis=1))) > _NO_FIELD_GAUSS:
        return field / _ARDUPILOT_HIGHRES_PER_MGAUSS
    return field * MGAUSS_PER_GAUSS
