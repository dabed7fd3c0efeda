"""Which compasses a vehicle has, and what steers its yaw, as far as its parameters tell.

ArduPilot numbers `COMPASS_USEn` and its telemetry by priority: the first compass that is used steers, unless
EKF3 is told to take its yaw elsewhere (EK3_SRC1_YAW; before version 4.1 EK3_MAG_CAL 5 and 6). PX4 takes the
sensor of the highest CAL_MAGn_PRIO, unless a second antenna (EKF2_GPS_CTRL bit 3, before 1.14 EKF2_AID_MASK
bit 7) or nothing (EKF2_MAG_TYPE) gives it its yaw.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from mavcompass.compass_parameters import ardupilot_name, ardupilot_naming, px4_name

# A compass (from 1), the satellite receivers, neither; None where the parameters do not tell.
SteeringSource = int | Literal["gps", "other"] | None

ARDUPILOT_COMPASSES, PX4_COMPASSES = (1, 2, 3), (1, 2, 3, 4)
# AHRS_EKF_TYPE: DCM, EKF2, EKF3; what is beyond them takes its attitude from outside.
_DCM, _EKF2, _EKF3 = 0.0, 2.0, 3.0
_YAW_SOURCES: dict[float, Literal["gps", "other"]] = {  # EK3_SRC1_YAW: 1 is the compass
    0.0: "other",
    2.0: "gps",
    3.0: "gps",  # and the compass where the receivers have no yaw
    6.0: "other",  # external navigation
    8.0: "other",  # the direction of the velocity (GSF)
}
_EXTERNAL_YAW = (5.0, 6.0)  # EK3_MAG_CAL before EK3_SRC1_YAW came
LEARN_INFLIGHT = 3.0  # COMPASS_LEARN: no compass is used while it learns
_PX4_NO_COMPASS = (5.0, 6.0)  # EKF2_MAG_TYPE: none, at the start only
_PX4_GPS_YAW = {"EKF2_GPS_CTRL": 1 << 3, "EKF2_AID_MASK": 1 << 7}
# What PX4 takes for a CAL_MAGn_PRIO of -1: of a sensor inside the flight controller (ROT -1), of one outside.
_PX4_INTERNAL_PRIORITY, _PX4_EXTERNAL_PRIORITY = 50.0, 75.0


def compasses_of(
    autopilot: str, parameters: Mapping[str, float], reporting: Iterable[int] = ()
) -> tuple[int, ...]:
    """List the compasses that a vehicle has, from 1: those that report, and those that have an id.

    `reporting` are those a field other than zero was heard or recorded of. An id alone is a promise: PX4
    keeps that of a sensor which is gone.
    """
    return tuple(sorted({*reporting, *_with_id(autopilot, parameters)}))


def _with_id(autopilot: str, parameters: Mapping[str, float]) -> list[int]:
    if autopilot == "px4":
        return [i for i in PX4_COMPASSES if parameters.get(px4_name("ID", i), 0.0) != 0.0]
    naming = ardupilot_naming(parameters)
    return [
        instance
        for instance in ARDUPILOT_COMPASSES
        if ardupilot_name("OFS_X", instance, naming) in parameters
        # Firmware that does not tell a device id has the compass that it has offsets for.
        and parameters.get(ardupilot_name("DEV_ID", instance, naming), 1.0) != 0.0
    ]


def steering_source(autopilot: str, parameters: Mapping[str, float]) -> SteeringSource:
    """Tell which compass (from 1), or "gps", or "other", the autopilot takes its yaw from.

    `autopilot` is "px4", or ArduPilot's rules are tried. Returns None where the parameters do not tell: too
    few of them are known, ArduPilot's compasses are about to change places, or PX4 chooses among sensors of
    the same priority, or among several estimators.
    "gps" is what the parameters ask for: receivers that give no yaw leave PX4 and EK3_SRC1_YAW 3 with a
    compass.
    """
    elsewhere = yaw_elsewhere(autopilot, parameters)
    if elsewhere is not None:
        return elsewhere[0]
    return _px4_compass(parameters) if autopilot == "px4" else _ardupilot_compass(parameters)


def yaw_elsewhere(
    autopilot: str, parameters: Mapping[str, float]
) -> tuple[Literal["gps", "other"], str] | None:
    """Tell what gives the yaw in the compasses' place, and the parameter that says so; None for nothing."""
    return _px4_elsewhere(parameters) if autopilot == "px4" else _ardupilot_elsewhere(parameters)


def _ardupilot_elsewhere(parameters: Mapping[str, float]) -> tuple[Literal["gps", "other"], str] | None:
    estimator = parameters.get("AHRS_EKF_TYPE", _EKF3)
    if estimator not in (_DCM, _EKF2, _EKF3):
        return "other", "AHRS_EKF_TYPE"
    if estimator == _EKF3:
        source = parameters.get("EK3_SRC1_YAW")
        if source in _YAW_SOURCES:
            return _YAW_SOURCES[source], "EK3_SRC1_YAW"
        if source is None and parameters.get("EK3_MAG_CAL") in _EXTERNAL_YAW:
            return "gps", "EK3_MAG_CAL"
    if parameters.get("COMPASS_ENABLE") == 0.0:
        return "other", "COMPASS_ENABLE"
    return ("other", "COMPASS_LEARN") if parameters.get("COMPASS_LEARN") == LEARN_INFLIGHT else None


def _ardupilot_compass(parameters: Mapping[str, float]) -> SteeringSource:
    naming = ardupilot_naming(parameters)

    def told(quantity: str, instance: int) -> float | None:
        return parameters.get(ardupilot_name(quantity, instance, naming))

    uses = {i: told("USE", i) for i in ARDUPILOT_COMPASSES if told("USE", i) is not None}
    if not uses:
        return None
    ids = {i: told("DEV_ID", i) for i in ARDUPILOT_COMPASSES}
    first_choices = {i: parameters.get(f"COMPASS_PRIO{i}_ID") for i in ARDUPILOT_COMPASSES}
    if any(first_choices[i] in {*ids.values()} - {ids[i], 0.0, None} for i in ARDUPILOT_COMPASSES):
        return None  # between a change of priorities and the start that makes it, or before version 4.1
    used = [instance for instance, use in uses.items() if use]
    # A slot without a sensor; but where none tells an id, the firmware is one that tells none.
    found = [instance for instance in used if ids[instance] != 0.0] or used
    first = int(parameters.get("COMPASS_PRIMARY", 0.0)) + 1  # before version 4.1
    return first if first in found else next(iter(found), "other")


def _px4_elsewhere(parameters: Mapping[str, float]) -> tuple[Literal["gps", "other"], str] | None:
    if parameters.get("EKF2_MAG_TYPE") in _PX4_NO_COMPASS:
        return "other", "EKF2_MAG_TYPE"
    if parameters.get("SYS_HAS_MAG") == 0.0:
        return "other", "SYS_HAS_MAG"
    for name, bit in _PX4_GPS_YAW.items():
        if int(parameters.get(name, 0.0)) & bit:
            return "gps", name
    return None


def _px4_compass(parameters: Mapping[str, float]) -> SteeringSource:
    if parameters.get("SENS_MAG_MODE") == 0.0 and parameters.get("EKF2_MULTI_MAG", 0.0) > 1.0:
        return None  # an estimator for each compass, and a choice among them in flight
    priorities = {
        instance: _px4_priority(parameters, instance)
        for instance in PX4_COMPASSES
        if px4_name("PRIO", instance) in parameters and parameters.get(px4_name("ID", instance)) != 0.0
    }
    if not priorities:
        return None
    highest = max(priorities.values())
    first = [instance for instance, priority in priorities.items() if priority == highest]
    return "other" if highest == 0.0 else first[0] if len(first) == 1 else None


def _px4_priority(parameters: Mapping[str, float], instance: int) -> float:
    priority = parameters[px4_name("PRIO", instance)]
    if priority >= 0.0:
        return priority
    internal = parameters.get(px4_name("ROT", instance), -1.0) < 0.0
    return _PX4_INTERNAL_PRIORITY if internal else _PX4_EXTERNAL_PRIORITY
