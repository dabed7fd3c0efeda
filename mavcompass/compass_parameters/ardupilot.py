"""ArduPilot's names for a compass's correction and mounting, and their meaning.

`field = M ((raw + OFS) SCALE) + MOT load`, milligauss, in body axes. An all-zero DIA means no matrix; a SCALE
outside [1/1.5, 1.5] is ignored; MOTCT 1 is throttle, 2 is battery current. With PMOT_EN compass 1 has instead
of that one vector for each of the motors 1 to 4, added behind the matrix, too (AP_Compass_Backend.cpp,
correct_field; Compass_PerMotor.cpp, compensate); PMOT_EXP is its load's power.

An external compass is mounted as its COMPASS_ORIENT says, one inside the flight controller as
AHRS_ORIENTATION does. Both are numbers of MAV_SENSOR_ORIENTATION up to 43, or name free angles: since 4.2
two sets of them, for whichever sensor, 101 for CUST_ROT1_ROLL, PITCH, YAW and 102 for CUST_ROT2_..; before,
100 for COMPASS_CUS_ROLL, PIT, YAW (and AHRS_CUSTOM_.. of the board). Angles are taken over at the start.
A number that it does not know turns nothing, and is an internal error that forbids arming.
(AP_Compass_Backend::rotate_field, AP_CustomRotations, AP_Math/rotations.h.)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from mavcompass.correction import USUAL_EXPONENT, FieldCorrection, MotorSource, Vector
from mavcompass.errors import Refused
from mavcompass.frames import (
    NUMBERED,
    NUMBERED_WITHIN_RAD,
    FloatArray,
    Orientations,
    angle_between,
    angles_of,
    nearest,
    nearest_in_words,
    rotation_of,
    spelled,
)

ArduPilotNaming = Literal["COMPASS_OFS2_X", "COMPASS2_OFS_X"]

ARDUPILOT_SCALE_LIMITS = (1.0 / 1.5, 1.5)
_AXES = "XYZ"
_MOTOR_SOURCES: dict[int, MotorSource] = {1: "throttle", 2: "current"}
_MOTOR_SOURCE_CODES = {"none": 0, "throttle": 1, "current": 2}
PER_MOTOR, _EXPONENT = "COMPASS_PMOT_EN", "COMPASS_PMOT_EXP"
_VECTORS = tuple(f"COMPASS_PMOT{motor}_{axis}" for motor in range(1, 5) for axis in _AXES)
# Hidden from the list, but known by name, while PER_MOTOR is 0.
PER_MOTOR_NAMES = (_EXPONENT, *_VECTORS)

# The name says 68 and 293 degrees; the firmware's own numbers are these.
ARDUPILOT_ORIENTATIONS: Orientations = {**NUMBERED, 38: rotation_of((90.0, 68.8, 293.3))}
_ANGLES_BEFORE_4_2 = ("COMPASS_CUS_ROLL", "COMPASS_CUS_PIT", "COMPASS_CUS_YAW")
_BOARD_BEFORE_4_2 = ("AHRS_CUSTOM_ROLL", "AHRS_CUSTOM_PIT", "AHRS_CUSTOM_YAW")
_ANGLES = {101 + n: tuple(f"CUST_ROT{n + 1}_{angle}" for angle in ("ROLL", "PITCH", "YAW")) for n in (0, 1)}


def ardupilot_name(quantity: str, instance: int, naming: ArduPilotNaming = "COMPASS_OFS2_X") -> str:
    """Spell a compass parameter: ('OFS_X', 2) is COMPASS_OFS2_X, or COMPASS2_OFS_X in the newer scheme.

    `quantity` is the name without prefix and number: OFS_X, DIA_Y, ODI_Z, MOT_X, SCALE, USE, ORIENT,
    EXTERNAL, DEV_ID. `instance` counts from 1.
    """
    if naming == "COMPASS2_OFS_X":
        return f"COMPASS{instance}_{'EXTERN' if quantity == 'EXTERNAL' else quantity}"
    number = "" if instance == 1 else str(instance)
    if quantity == "EXTERNAL" and instance > 1:
        return f"COMPASS_EXTERN{number}"
    stem, dash, axis = quantity.rpartition("_")
    if dash and axis in _AXES:
        return f"COMPASS_{stem}{number}_{axis}"
    return f"COMPASS_{quantity}{number}"


def ardupilot_naming(names: Mapping[str, float]) -> ArduPilotNaming:
    """Tell which of the two naming schemes a vehicle uses from the parameters it has."""
    return "COMPASS2_OFS_X" if "COMPASS1_OFS_X" in names else "COMPASS_OFS2_X"


def ardupilot_correction_names(instance: int, naming: ArduPilotNaming = "COMPASS_OFS2_X") -> tuple[str, ...]:
    """List the parameters that make up one compass's correction, offsets first."""
    vectors = [f"{stem}_{axis}" for stem in ("OFS", "DIA", "ODI", "MOT") for axis in _AXES]
    return tuple(ardupilot_name(q, instance, naming) for q in [*vectors, "SCALE"])


def _ardupilot_vector(
    parameters: Mapping[str, float], stem: str, instance: int, naming: ArduPilotNaming, absent: float = 0.0
) -> Vector:
    x, y, z = (parameters.get(ardupilot_name(f"{stem}_{a}", instance, naming), absent) for a in _AXES)
    return (float(x), float(y), float(z))


def ardupilot_correction(parameters: Mapping[str, float], instance: int) -> FieldCorrection:
    """Read the correction in force off a vehicle's parameters, as the firmware applies it.

    Parameters that are absent count as their default. `instance` counts from 1.
    """
    naming = ardupilot_naming(parameters)
    diagonals = _ardupilot_vector(parameters, "DIA", instance, naming, absent=1.0)
    no_matrix = not any(diagonals)
    scale = float(parameters.get(ardupilot_name("SCALE", instance, naming), 0.0))
    low, high = ARDUPILOT_SCALE_LIMITS
    motors: tuple[float, ...] = _ardupilot_vector(parameters, "MOT", instance, naming)
    source = _MOTOR_SOURCES.get(int(parameters.get("COMPASS_MOTCT", 0.0)), "none")
    exponent = USUAL_EXPONENT
    if instance == 1 and parameters.get(PER_MOTOR):
        motors, source = tuple(float(parameters.get(name, 0.0)) for name in _VECTORS), "outputs"
        exponent = float(parameters.get(_EXPONENT, USUAL_EXPONENT))
    return FieldCorrection(
        offsets_mgauss=_ardupilot_vector(parameters, "OFS", instance, naming),
        diagonals=(1.0, 1.0, 1.0) if no_matrix else diagonals,
        off_diagonals=(
            (0.0, 0.0, 0.0) if no_matrix else _ardupilot_vector(parameters, "ODI", instance, naming)
        ),
        scale=scale if low <= scale <= high else 1.0,
        motor_mgauss=motors,
        motor_source=source,
        motor_exponent=exponent,
    )


def ardupilot_orientations(parameters: Mapping[str, float]) -> dict[int, FloatArray]:
    """List the orientations that a vehicle's firmware knows, by number, each (3, 3)."""
    return {
        **ARDUPILOT_ORIENTATIONS,
        **{n: _free(parameters, names) for n, names in _slots(parameters).items()},
    }


def ardupilot_angle_names(parameters: Mapping[str, float]) -> tuple[str, ...]:
    """List the free angles that a vehicle's firmware has, as its other parameters tell."""
    if "CUST_ROT_ENABLE" in parameters:
        return tuple(name for names in _ANGLES.values() for name in names)
    return _ANGLES_BEFORE_4_2 + _BOARD_BEFORE_4_2


def ardupilot_is_external(parameters: Mapping[str, float], instance: int) -> bool:
    """Tell whether a compass is mounted by itself, outside the flight controller."""
    return parameters.get(ardupilot_name("EXTERNAL", instance, ardupilot_naming(parameters)), 0.0) != 0.0


def ardupilot_sensor_to_body(parameters: Mapping[str, float], instance: int) -> FloatArray:
    """Return the rotation in force from the sensor's axes to the vehicle's, shape (3, 3)."""
    number = _orientation(parameters, instance)
    if number == 100 and not ardupilot_is_external(parameters, instance):
        return _free(parameters, _BOARD_BEFORE_4_2)
    return ardupilot_orientations(parameters).get(number, np.eye(3))


def ardupilot_mounting_values(
    parameters: Mapping[str, float], instance: int, rotation: FloatArray
) -> dict[str, float]:
    """Spell a sensor-to-body rotation, shape (3, 3), as the parameters that mount a compass so.

    A number where one is equal; else a set of free angles that holds this rotation, or that nothing else uses
    as far as can be seen. Raises Refused, saying why and what to do, for an internal compass and where no set
    is free.
    """
    naming = ardupilot_naming(parameters)
    orient, external = (ardupilot_name(q, instance, naming) for q in ("ORIENT", "EXTERNAL"))
    if not ardupilot_is_external(parameters, instance):
        raise Refused(
            f"Compass {instance} is inside the flight controller ({external} is 0): {orient} is not for it.",
            f"See whether the flight controller itself is mounted as AHRS_ORIENTATION says; set {external} to"
            " 2 if this compass is on a cable of its own.",
        )
    known, slots = ardupilot_orientations(parameters), _slots(parameters)
    number, off_rad = nearest(rotation, known)
    if off_rad <= NUMBERED_WITHIN_RAD:
        return {orient: float(number)}
    taken = {_orientation(parameters, i) for i in (1, 2, 3) if i != instance}
    taken.add(int(parameters.get("AHRS_ORIENTATION", 0.0)))
    unused = [n for n in slots if n == _orientation(parameters, instance)]
    unused += [n for n in slots if angle_between(known[n], np.eye(3)) == 0.0]
    for number in unused:
        if number not in taken:
            enable = {"CUST_ROT_ENABLE": 1.0} if number in _ANGLES else {}
            angles = dict(zip(slots[number], angles_of(rotation), strict=True))
            return enable | angles | {orient: float(number)}
    raise Refused(
        f"Compass {instance} is mounted at {spelled(rotation)}, and {nearest_in_words(rotation, known)}; this"
        f" firmware {'has no free angles left' if slots else 'knows no free angles'}.",
        "Mount it at a multiple of 45 degrees, or "
        + ("set the angles of one that nothing uses to 0." if slots else "install a newer firmware."),
    )


def _orientation(parameters: Mapping[str, float], instance: int) -> int:
    if not ardupilot_is_external(parameters, instance):
        return int(parameters.get("AHRS_ORIENTATION", 0.0))
    return int(parameters.get(ardupilot_name("ORIENT", instance, ardupilot_naming(parameters)), 0.0))


def _slots(parameters: Mapping[str, float]) -> Mapping[int, tuple[str, ...]]:
    """List the sets of free angles that the firmware has for a compass: number and names."""
    if "CUST_ROT_ENABLE" in parameters:
        return _ANGLES
    return {100: _ANGLES_BEFORE_4_2} if _ANGLES_BEFORE_4_2[0] in parameters else {}


def _free(parameters: Mapping[str, float], names: tuple[str, ...]) -> FloatArray:
    return rotation_of([float(parameters.get(name, 0.0)) for name in names])


def ardupilot_values(
    correction: FieldCorrection, instance: int, naming: ArduPilotNaming = "COMPASS_OFS2_X"
) -> dict[str, float]:
    """Spell a correction as ArduPilot parameters; motor terms only where it has a motor source.

    Raises Refused for what only compass 1 can have.
    """
    vectors: dict[str, tuple[float, ...]] = {
        "OFS": correction.offsets_mgauss,
        "DIA": correction.diagonals,
        "ODI": correction.off_diagonals,
    }
    if correction.motor_source in _MOTOR_SOURCES.values():
        vectors["MOT"] = correction.motor_mgauss
    values = {
        ardupilot_name(f"{stem}_{axis}", instance, naming): float(value)
        for stem, vector in vectors.items()
        for axis, value in zip(_AXES, vector, strict=True)
    }
    values[ardupilot_name("SCALE", instance, naming)] = float(correction.scale)
    if correction.motor_source == "outputs":
        if instance != 1:
            raise Refused(
                f"Compass {instance}: the firmware corrects only compass 1 motor by motor.",
                "Give it one motor term for all, by current or throttle.",
            )
        values |= {PER_MOTOR: 1.0, _EXPONENT: correction.motor_exponent}
        values |= dict(zip(_VECTORS, correction.motor_mgauss, strict=True))
    elif correction.motor_source != "none":
        values["COMPASS_MOTCT"] = float(_MOTOR_SOURCE_CODES[correction.motor_source])
    return values
