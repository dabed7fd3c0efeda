"""What steers the autopilot's yaw, off its parameters."""

from __future__ import annotations

import pytest

from mavcompass.steering import SteeringSource, steering_source

USED = {"COMPASS_USE": 1.0, "COMPASS_USE2": 1.0, "COMPASS_USE3": 1.0}
ARDUPILOT: list[tuple[dict[str, float], SteeringSource]] = [
    ({}, None),
    (USED, 1),
    (USED | {"COMPASS_USE": 0.0}, 2),
    (USED | {"COMPASS_USE": 0.0, "COMPASS_USE2": 0.0}, 3),
    (dict.fromkeys(USED, 0.0), "other"),
    ({"COMPASS1_OFS_X": 1.0, "COMPASS1_USE": 0.0, "COMPASS2_USE": 1.0}, 2),
    # A slot without a sensor does not steer, but firmware may tell no id of any.
    (USED | {"COMPASS_DEV_ID": 0.0, "COMPASS_DEV_ID2": 7.0}, 2),
    (USED | {"COMPASS_DEV_ID": 0.0, "COMPASS_DEV_ID2": 0.0, "COMPASS_DEV_ID3": 0.0}, 1),
    (USED | {"COMPASS_DEV_ID": 7.0, "COMPASS_DEV_ID2": 8.0, "COMPASS_PRIO1_ID": 7.0}, 1),
    # Priorities that will be in force after the next start, or names that do not follow them.
    (USED | {"COMPASS_DEV_ID": 7.0, "COMPASS_DEV_ID2": 8.0, "COMPASS_PRIO1_ID": 8.0}, None),
    (USED | {"COMPASS_DEV_ID": 7.0, "COMPASS_PRIO1_ID": 9.0, "COMPASS_PRIO2_ID": 0.0}, 1),
    (USED | {"COMPASS_PRIMARY": 1.0}, 2),
    (USED | {"COMPASS_PRIMARY": 1.0, "COMPASS_USE2": 0.0}, 1),
    (USED | {"COMPASS_ENABLE": 0.0}, "other"),
    (USED | {"COMPASS_LEARN": 3.0}, "other"),
    (USED | {"EK3_SRC1_YAW": 1.0}, 1),
    *((USED | {"EK3_SRC1_YAW": source}, "gps") for source in (2.0, 3.0)),
    *((USED | {"EK3_SRC1_YAW": source}, "other") for source in (0.0, 6.0, 8.0)),
    *((USED | {"EK3_MAG_CAL": way}, "gps") for way in (5.0, 6.0)),
    (USED | {"EK3_MAG_CAL": 5.0, "EK3_SRC1_YAW": 1.0}, 1),
    (USED | {"EK3_SRC1_YAW": 2.0, "AHRS_EKF_TYPE": 2.0}, 1),
    (USED | {"EK3_SRC1_YAW": 2.0, "AHRS_EKF_TYPE": 0.0}, 1),
    (USED | {"EK3_SRC1_YAW": 1.0, "AHRS_EKF_TYPE": 11.0}, "other"),
]
TWO = {"CAL_MAG0_PRIO": 50.0, "CAL_MAG1_PRIO": 75.0}
PX4: list[tuple[dict[str, float], SteeringSource]] = [
    ({}, None),
    ({"CAL_MAG0_PRIO": 50.0}, 1),
    (TWO, 2),
    (TWO | {"CAL_MAG1_PRIO": 50.0}, None),
    (TWO | {"CAL_MAG1_PRIO": 0.0}, 1),
    (dict.fromkeys(TWO, 0.0), "other"),
    ({"CAL_MAG0_PRIO": 50.0, "CAL_MAG3_PRIO": 75.0}, 4),
    (TWO | {"CAL_MAG1_ID": 0.0}, 1),
    # -1 is 50 inside the flight controller, 75 outside.
    ({"CAL_MAG0_PRIO": -1.0, "CAL_MAG0_ROT": -1.0, "CAL_MAG1_PRIO": -1.0, "CAL_MAG1_ROT": 0.0}, 2),
    ({"CAL_MAG0_PRIO": -1.0, "CAL_MAG0_ROT": 6.0, "CAL_MAG1_PRIO": 60.0}, 1),
    (TWO | {"EKF2_MAG_TYPE": 0.0}, 2),
    *((TWO | {"EKF2_MAG_TYPE": kind}, "other") for kind in (5.0, 6.0)),
    (TWO | {"SYS_HAS_MAG": 0.0}, "other"),
    (TWO | {"EKF2_GPS_CTRL": 7.0}, 2),
    (TWO | {"EKF2_GPS_CTRL": 15.0}, "gps"),
    (TWO | {"EKF2_AID_MASK": 129.0}, "gps"),
    (TWO | {"SENS_MAG_MODE": 0.0, "EKF2_MULTI_MAG": 3.0}, None),
    (TWO | {"SENS_MAG_MODE": 1.0, "EKF2_MULTI_MAG": 3.0}, 2),
]


@pytest.mark.parametrize(
    ("autopilot", "parameters", "source"),
    [("ardupilot", *row) for row in ARDUPILOT] + [("px4", *row) for row in PX4],
)
def test_parameters_tell_what_steers(
    autopilot: str, parameters: dict[str, float], source: SteeringSource
) -> None:
    assert steering_source(autopilot, parameters) == source
