"""The autopilots' names for a compass's correction, and their meaning: the one place that knows.

ArduPilot: `field = M ((raw + OFS) SCALE) + MOT load`, milligauss, in body axes. An all-zero DIA means
no matrix; a SCALE outside [1/1.5, 1.5] is ignored; MOTCT 1 is throttle, 2 is battery current.

PX4: `field = R S ((raw + power COMP) - OFF)`, gauss, in the *sensor's* axes, with R the sensor's
rotation: the offset has the other sign, the other unit and the other frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from mavcompass.correction import FieldCorrection, MotorSource, Vector
from mavcompass.frames import FloatArray, sensor_orientation_matrix
from mavcompass.track import InForce, Track
from mavcompass.units import MGAUSS_PER_GAUSS

ArduPilotNaming = Literal["COMPASS_OFS2_X", "COMPASS2_OFS_X"]

ARDUPILOT_SCALE_LIMITS = (1.0 / 1.5, 1.5)
_AXES = "XYZ"
_MOTOR_SOURCES: dict[int, MotorSource] = {1: "throttle", 2: "current"}
_MOTOR_SOURCE_CODES = {"none": 0, "throttle": 1, "current": 2}


def ardupilot_name(quantity: str, instance: int, naming: ArduPilotNaming = "COMPASS_OFS2_X") -> str:
    """Spell a compass parameter: ('OFS_X', 2) is COMPASS_OFS2_X, or COMPASS2_OFS_X in the newer scheme.

    `quantity` is the name without prefix and number: OFS_X, DIA_Y, ODI_Z, MOT_X, SCALE, USE, ORIENT,
    EXTERNAL, DEV_ID. `instance` counts from 1.
    """
    if naming == "COMPASS2_OFS_X":
        return f"COMPASS{instance}_{quantity}"
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
    return FieldCorrection(
        offsets_mgauss=_ardupilot_vector(parameters, "OFS", instance, naming),
        diagonals=(1.0, 1.0, 1.0) if no_matrix else diagonals,
        off_diagonals=(
            (0.0, 0.0, 0.0) if no_matrix else _ardupilot_vector(parameters, "ODI", instance, naming)
        ),
        scale=scale if low <= scale <= high else 1.0,
        motor_mgauss=_ardupilot_vector(parameters, "MOT", instance, naming),
        motor_source=_MOTOR_SOURCES.get(int(parameters.get("COMPASS_MOTCT", 0.0)), "none"),
    )


def ardupilot_values(
    correction: FieldCorrection, instance: int, naming: ArduPilotNaming = "COMPASS_OFS2_X"
) -> dict[str, float]:
    """Spell a correction as ArduPilot parameters; motor terms only where it has a motor source."""
    vectors = {
        "OFS": correction.offsets_mgauss,
        "DIA": correction.diagonals,
        "ODI": correction.off_diagonals,
    }
    if correction.motor_source != "none":
        vectors["MOT"] = correction.motor_mgauss
    values = {
        ardupilot_name(f"{stem}_{axis}", instance, naming): float(value)
        for stem, vector in vectors.items()
        for axis, value in zip(_AXES, vector, strict=True)
    }
    values[ardupilot_name("SCALE", instance, naming)] = float(correction.scale)
    if correction.motor_source != "none":
        values["COMPASS_MOTCT"] = float(_MOTOR_SOURCE_CODES[correction.motor_source])
    return values


def px4_name(quantity: str, instance: int) -> str:
    """Spell a PX4 compass parameter: ('XOFF', 1) is CAL_MAG0_XOFF. `instance` counts from 1."""
    return f"CAL_MAG{instance - 1}_{quantity}"


def px4_rotation(parameters: Mapping[str, float], instance: int) -> FloatArray:
    """Return the sensor-to-body rotation, shape (3, 3), that CAL_MAGn_ROT sets.

    -1 is a sensor inside the flight controller, which is mounted as SENS_BOARD_ROT says.
    """
    orientation = int(parameters.get(px4_name("ROT", instance), -1))
    if orientation < 0:
        orientation = int(parameters.get("SENS_BOARD_ROT", 0))
    return sensor_orientation_matrix(orientation)


def _px4_scale(parameters: Mapping[str, float], instance: int) -> FloatArray:
    def get(quantity: str, default: float) -> float:
        return float(parameters.get(px4_name(quantity, instance), default))

    scale = np.diag([get(f"{axis}SCALE", 1.0) for axis in _AXES])
    for quantity, (row, column) in {"XODIAG": (0, 1), "YODIAG": (0, 2), "ZODIAG": (1, 2)}.items():
        scale[row, column] = scale[column, row] = get(quantity, 0.0)
    return scale


def px4_correction(parameters: Mapping[str, float], instance: int) -> FieldCorrection:
    """Read PX4's correction off its parameters, for raw readings turned into body axes.

    With raw_body = R raw: field = (R S R^T) (raw_body - R OFF), so the offsets are -R OFF.
    `instance` counts from 1 (CAL_MAG0 is the first).
    """
    rotation = px4_rotation(parameters, instance)
    offset_gauss, power_gauss = (
        np.array([float(parameters.get(px4_name(f"{axis}{q}", instance), 0.0)) for axis in _AXES])
        for q in ("OFF", "COMP")
    )
    matrix = rotation @ _px4_scale(parameters, instance) @ rotation.T
    source = _MOTOR_SOURCES.get(int(parameters.get("CAL_MAG_COMP_TYP", 0.0)), "none")
    # Gauss at full throttle, but gauss per kiloampere: that is milligauss per ampere.
    load_mgauss = power_gauss * (1.0 if source == "current" else MGAUSS_PER_GAUSS)
    return FieldCorrection.from_matrix(
        -rotation @ offset_gauss * MGAUSS_PER_GAUSS,
        matrix,
        motor_mgauss=matrix @ rotation @ load_mgauss,
        motor_source=source,
    )


def px4_values(
    correction: FieldCorrection, instance: int, rotation: FloatArray | None = None
) -> dict[str, float]:
    """Spell a body-axes correction as PX4 parameters of a sensor mounted with `rotation` (3, 3).

    PX4 has no scalar scale: it goes into the matrix. The motor term is left as it is on the vehicle.
    """
    r = np.eye(3) if rotation is None else rotation
    scale = r.T @ correction.matrix @ r
    offset_gauss = -r.T @ np.asarray(correction.offsets_mgauss) / MGAUSS_PER_GAUSS
    values = {px4_name(f"{axis}OFF", instance): float(offset_gauss[i]) for i, axis in enumerate(_AXES)}
    values |= {px4_name(f"{axis}SCALE", instance): float(scale[i, i]) for i, axis in enumerate(_AXES)}
    values |= {
        px4_name("XODIAG", instance): float(scale[0, 1]),
        px4_name("YODIAG", instance): float(scale[0, 2]),
        px4_name("ZODIAG", instance): float(scale[1, 2]),
    }
    return values


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
