"""PX4's names for a compass's correction and mounting, and their meaning.

`field = R S ((raw + power COMP) - OFF)`, gauss, in the *sensor's* axes: the offset has the other sign, the
other unit and the other frame than ArduPilot's.

R is what CAL_MAGn_ROT says, and then SENS_BOARD_X/Y/Z_OFF of the level calibration, for every sensor (before
1.12 not for external ones). ROT is a number of MAV_SENSOR_ORIENTATION up to 40; -1 for a sensor inside the
flight controller, which is mounted as SENS_BOARD_ROT says; or, since 1.15, 100 for the angles CAL_MAGn_ROLL,
PITCH and YAW: where one of these is not zero PX4 makes ROT 100 itself. A number that it does not know it
takes for 0.
(src/lib/sensor_calibration/Magnetometer.cpp, src/lib/conversion/rotation.h.)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mavcompass.correction import FieldCorrection, MotorSource, Vector
from mavcompass.errors import Refused
from mavcompass.frames import (
    NUMBERED,
    NUMBERED_WITHIN_RAD,
    FloatArray,
    Orientations,
    angles_of,
    nearest,
    nearest_in_words,
    rotation_of,
    spelled,
)
from mavcompass.units import MGAUSS_PER_GAUSS

PX4_CUSTOM = 100
PX4_ANGLES = ("ROLL", "PITCH", "YAW")
PX4_BOARD = ("SENS_BOARD_ROT", "SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF")
PX4_ORIENTATIONS: Orientations = {number: NUMBERED[number] for number in range(41)}
# Numbers that were PX4's own until 1.11, and are none since.
_UNTIL_1_11: Orientations = {
    number: rotation_of(angles)
    for number, angles in {
        41: (270, 0, 180), 42: (270, 0, 270), 43: (0, 90, 180), 44: (0, 9, 180),
        45: (0, 45, 0), 46: (270, 0, 225), 47: (270, 0, 315),
    }.items()
}  # fmt: skip
_READ = {**PX4_ORIENTATIONS, **_UNTIL_1_11}
_AXES = "XYZ"
_MOTOR_SOURCES: dict[int, MotorSource] = {1: "throttle", 2: "current"}
# Gauss at full throttle, but gauss per kiloampere: that is milligauss per ampere.
_MOTOR_UNIT_MGAUSS = {"throttle": MGAUSS_PER_GAUSS, "current": 1.0, "none": MGAUSS_PER_GAUSS}


def px4_name(quantity: str, instance: int) -> str:
    """Spell a PX4 compass parameter: ('XOFF', 1) is CAL_MAG0_XOFF. `instance` counts from 1."""
    return f"CAL_MAG{instance - 1}_{quantity}"


def px4_sensor_to_body(parameters: Mapping[str, float], instance: int) -> FloatArray:
    """Return the rotation in force from the sensor's axes to the vehicle's, shape (3, 3)."""
    number = int(parameters.get(px4_name("ROT", instance), -1))
    angles_deg = _angles_deg(parameters, instance)
    if number < 0:
        rotation = _READ.get(int(parameters.get("SENS_BOARD_ROT", 0)), np.eye(3))
    elif number == PX4_CUSTOM or any(angles_deg):
        rotation = rotation_of(angles_deg)
    else:
        rotation = _READ.get(number, np.eye(3))
    return _level(parameters) @ rotation


def px4_mounting_values(
    parameters: Mapping[str, float], instance: int, rotation: FloatArray
) -> dict[str, float]:
    """Spell a sensor-to-body rotation, shape (3, 3), as the parameters that mount a compass so.

    A number where one is equal, free angles otherwise. Raises Refused, saying why and what to do, for a
    compass inside the flight controller and for firmware that knows no free angles.
    """
    rot = px4_name("ROT", instance)
    if parameters.get(rot, -1.0) < 0.0:
        raise Refused(
            f"Compass {instance} is inside the flight controller ({rot} is -1): it cannot be turned alone.",
            "See whether the flight controller itself is mounted as SENS_BOARD_ROT says, or use another"
            " compass.",
        )
    angles = [px4_name(angle, instance) for angle in PX4_ANGLES]
    free = all(name in parameters for name in angles)
    before_level = _level(parameters).T @ rotation
    number, off_rad = nearest(before_level, PX4_ORIENTATIONS)
    if off_rad <= NUMBERED_WITHIN_RAD:
        return (dict.fromkeys(angles, 0.0) if free else {}) | {rot: float(number)}
    if not free:
        raise Refused(
            f"Compass {instance} is mounted at {spelled(before_level)}, for which this PX4 (before 1.15)"
            f" has no setting: {nearest_in_words(before_level, PX4_ORIENTATIONS)}.",
            "Mount it at a multiple of 45 degrees, or install a newer PX4.",
        )
    return {rot: float(PX4_CUSTOM)} | dict(zip(angles, angles_of(before_level), strict=True))


def px4_sensor_correction(parameters: Mapping[str, float], instance: int) -> FieldCorrection:
    """Read the correction off the parameters, for raw readings in the sensor's own axes."""

    def vector(quantity: str, absent: float = 0.0) -> Vector:
        x, y, z = (parameters.get(px4_name(f"{axis}{quantity}", instance), absent) for axis in _AXES)
        return (float(x), float(y), float(z))

    source = _MOTOR_SOURCES.get(int(parameters.get("CAL_MAG_COMP_TYP", 0.0)), "none")
    load_mgauss = np.array(vector("COMP")) * _MOTOR_UNIT_MGAUSS[source]
    linear = FieldCorrection(diagonals=vector("SCALE", 1.0), off_diagonals=vector("ODIAG")).matrix
    return FieldCorrection.from_matrix(
        -np.array(vector("OFF")) * MGAUSS_PER_GAUSS,
        linear,
        motor_mgauss=linear @ load_mgauss,
        motor_source=source,
    )


def px4_correction(parameters: Mapping[str, float], instance: int) -> FieldCorrection:
    """Read the correction in force off the parameters, for raw readings turned into body axes.

    `instance` counts from 1 (CAL_MAG0 is the first).
    """
    return px4_sensor_correction(parameters, instance).turned(px4_sensor_to_body(parameters, instance))


def px4_values(
    correction: FieldCorrection, instance: int, rotation: FloatArray | None = None
) -> dict[str, float]:
    """Spell a body-axes correction as PX4 parameters of a sensor mounted with `rotation` (3, 3).

    PX4 has no scalar scale: it goes into the matrix. Motor terms only where it has a motor source: PX4 takes
    them before its matrix, so those in force stay right when that changes.
    """
    of_sensor = correction if rotation is None else correction.turned(rotation.T)
    m = of_sensor.matrix
    source = correction.motor_source
    parts = {
        "OFF": -np.array(of_sensor.offsets_mgauss) / MGAUSS_PER_GAUSS,
        "SCALE": np.diag(m),
        "ODIAG": m[[0, 0, 1], [1, 2, 2]],
    }
    if source in _MOTOR_SOURCES.values():
        parts["COMP"] = np.linalg.solve(m, np.array(of_sensor.motor_mgauss)) / _MOTOR_UNIT_MGAUSS[source]
    values = {
        px4_name(f"{axis}{quantity}", instance): float(value)
        for quantity, vector in parts.items()
        for axis, value in zip(_AXES, vector, strict=True)
    }
    codes = [code for code, named in _MOTOR_SOURCES.items() if named == source]
    return values | dict.fromkeys(("CAL_MAG_COMP_TYP",) if codes else (), float(sum(codes)))


def _angles_deg(parameters: Mapping[str, float], instance: int) -> list[float]:
    return [float(parameters.get(px4_name(angle, instance), 0.0)) for angle in PX4_ANGLES]


def _level(parameters: Mapping[str, float]) -> FloatArray:
    return rotation_of([float(parameters.get(name, 0.0)) for name in PX4_BOARD[1:]])
