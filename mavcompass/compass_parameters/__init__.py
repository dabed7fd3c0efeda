"""The autopilots' names for how a compass is corrected and mounted, and their meaning: the one place.

Each autopilot has a file; what is asked of either goes through `sensor_to_body`, `mounting_values` and
`values`. A vehicle of unknown make is taken for ArduPilot's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mavcompass.compass_parameters.ardupilot import (
    ARDUPILOT_SCALE_LIMITS,
    PER_MOTOR,
    PER_MOTOR_NAMES,
    ArduPilotNaming,
    ardupilot_angle_names,
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_is_external,
    ardupilot_mounting_values,
    ardupilot_name,
    ardupilot_naming,
    ardupilot_orientations,
    ardupilot_sensor_to_body,
    ardupilot_values,
)
from mavcompass.compass_parameters.px4 import (
    PX4_ANGLES,
    PX4_BOARD,
    PX4_CUSTOM,
    PX4_ORIENTATIONS,
    px4_correction,
    px4_mounting_values,
    px4_name,
    px4_sensor_correction,
    px4_sensor_to_body,
    px4_values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.track import InForce, Track

__all__ = [
    "ARDUPILOT_SCALE_LIMITS",
    "PER_MOTOR",
    "PER_MOTOR_NAMES",
    "PX4_ANGLES",
    "PX4_BOARD",
    "PX4_CUSTOM",
    "PX4_ORIENTATIONS",
    "ArduPilotNaming",
    "ardupilot_angle_names",
    "ardupilot_correction",
    "ardupilot_correction_names",
    "ardupilot_is_external",
    "ardupilot_name",
    "ardupilot_naming",
    "ardupilot_orientations",
    "ardupilot_sensor_to_body",
    "ardupilot_values",
    "is_calibrated",
    "mounting_values",
    "orientation_name",
    "px4_correction",
    "px4_name",
    "px4_sensor_correction",
    "px4_sensor_to_body",
    "px4_values",
    "sensor_to_body",
    "values",
    "with_parameters_in_force",
]


def sensor_to_body(autopilot: str, parameters: Mapping[str, float], instance: int) -> FloatArray:
    """Return the rotation in force from a compass's axes to the vehicle's, shape (3, 3).

    `instance` counts from 1. A number that the firmware does not know is no rotation, as it takes it.
    """
    read = px4_sensor_to_body if autopilot == "px4" else ardupilot_sensor_to_body
    return read(parameters, instance)


def is_calibrated(
    autopilot: str, parameters: Mapping[str, float], instance: int, in_force: FieldCorrection
) -> bool:
    """Tell whether the autopilot takes a compass with this correction in force for calibrated.

    PX4 stores a sensor's id with its calibration, which may be zero; for ArduPilot offsets that are all zero
    are none.
    """
    stored = parameters.get(px4_name("ID", instance)) if autopilot == "px4" else None
    return any(in_force.offsets_mgauss) if stored is None else stored != 0.0


def orientation_name(autopilot: str, parameters: Mapping[str, float], instance: int) -> str:
    """Name the parameter that says how a compass is mounted; "" where the autopilot is unknown."""
    if autopilot == "px4":
        return px4_name("ROT", instance)
    return (
        ardupilot_name("ORIENT", instance, ardupilot_naming(parameters)) if autopilot == "ardupilot" else ""
    )


def mounting_values(
    autopilot: str, parameters: Mapping[str, float], instance: int, rotation: FloatArray
) -> dict[str, float]:
    """Spell a sensor-to-body rotation, shape (3, 3), as the parameters that mount a compass so.

    A numbered orientation where one is equal within `NUMBERED_WITHIN_RAD`, free angles where the firmware has
    them. Raises Refused, saying why and what to do, where there is no such setting.
    """
    spell = px4_mounting_values if autopilot == "px4" else ardupilot_mounting_values
    return spell(parameters, instance, rotation)


def values(
    autopilot: str,
    parameters: Mapping[str, float],
    instance: int,
    correction: FieldCorrection,
    turned: FloatArray | None = None,
) -> dict[str, float]:
    """Spell a correction, and before it a mounting that is to change, over the parameters in force.

    Args:
        autopilot: "px4"; any other is spelled as ArduPilot's.
        parameters: those in force. instance: the compass, from 1.
        correction: for raw readings in body axes, by the new mounting where there is one. Where it has no
            motor term, the one in force stays, and is turned with the compass.
        turned: what must come after the sensor-to-body rotation in force, shape (3, 3); None leaves that.

    Raises Refused where no parameters mount the compass so.
    """
    mounting: dict[str, float] = {}
    if turned is not None:
        wanted = turned @ sensor_to_body(autopilot, parameters, instance)
        mounting = mounting_values(autopilot, parameters, instance, wanted)
    if autopilot == "px4":
        rotation = px4_sensor_to_body({**parameters, **mounting}, instance)
        return mounting | px4_values(correction, instance, rotation)
    if turned is not None and correction.motor_source == "none":
        correction = correction.with_motor_of(ardupilot_correction(parameters, instance).turned(turned))
    if instance == 1 and parameters.get(PER_MOTOR) and correction.motor_source in ("throttle", "current"):
        mounting[PER_MOTOR] = 0.0  # which would keep these from working
    return mounting | ardupilot_values(correction, instance, ardupilot_naming(parameters))


def with_parameters_in_force(track: Track, parameters: Mapping[str, float]) -> Track:
    """Say which ArduPilot parameters were in force during a recording that does not tell them itself."""
    known = {**track.parameters, **parameters}
    compasses = {
        instance: replace(
            compass,
            in_force=(InForce(-np.inf, ardupilot_correction(known, instance)),),
            correction_known=True,
        )
        for instance, compass in track.compasses.items()
    }
    return replace(track, compasses=compasses, parameters=known)
