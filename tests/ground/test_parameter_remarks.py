"""What a person is told of a vehicle's compass parameters."""

from __future__ import annotations

import pytest

from mavcompass.parameter_remarks import parameter_remarks, remarks_said
from mavcompass.steering import compasses_of

TWO = {"COMPASS_DEV_ID": 5.0, "COMPASS_DEV_ID2": 6.0}
# Parameters, the compass, words of each remark in their order.
ARDUPILOT: list[tuple[dict[str, float], int, list[str]]] = [
    ({}, 1, []),
    ({"COMPASS_ENABLE": 1.0, "COMPASS_LEARN": 0.0, "COMPASS_USE": 1.0, "EK3_SRC1_YAW": 1.0}, 1, []),
    ({"COMPASS_ENABLE": 0.0}, 1, ["switched off"]),
    ({"COMPASS_LEARN": 3.0}, 1, ["in-flight learning"]),
    ({"COMPASS_LEARN": 1.0}, 1, ["go on changing"]),
    ({"COMPASS_LEARN": 2.0, "COMPASS_ENABLE": 0.0}, 1, ["switched off", "go on changing"]),
    ({"COMPASS_USE2": 0.0}, 1, []),
    ({"COMPASS_USE2": 0.0}, 2, ["COMPASS_USE2 is 0"]),
    ({"EK3_SRC1_YAW": 2.0}, 2, ["satellite receivers (EK3_SRC1_YAW is 2): no compass steers"]),
    ({"EK3_SRC1_YAW": 6.0}, 1, ["from elsewhere (EK3_SRC1_YAW is 6)"]),
    (TWO | {"COMPASS_PRIO1_ID": 5.0, "COMPASS_PRIO2_ID": 6.0}, 1, []),
    (TWO | {"COMPASS_PRIO1_ID": 6.0}, 1, ["compass 2's: after the next start"]),
    (TWO | {"COMPASS_PRIO1_ID": 6.0}, 2, []),
    (TWO | {"COMPASS_PRIO1_ID": 9.0}, 1, ["a sensor that was not found"]),
    ({"COMPASS_PRIO1_ID": 6.0}, 1, []),  # what is not there changes no places
    (TWO | {"COMPASS_PRIO1_ID": 0.0}, 1, []),
    (
        TWO | {"COMPASS_DEV_ID2": 5.0},
        2,
        ["Compasses 1 and 2 have the same device id (COMPASS_DEV_ID and COMPASS_DEV_ID2 are 5)"],
    ),
    ({"COMPASS_DEV_ID": 0.0, "COMPASS_DEV_ID2": 0.0}, 1, ["COMPASS_DEV_ID is 0 although"]),
    ({"COMPASS1_OFS_X": 1.0, "COMPASS1_DEV_ID": 4.0, "COMPASS3_DEV_ID": 4.0}, 3, ["the same device id"]),
    ({"COMPASS_AUTODEC": 1.0, "COMPASS_DEC": 0.1}, 1, []),
    ({"COMPASS_AUTODEC": 0.0, "COMPASS_DEC": 0.1}, 1, ["a declination of 5.7 deg set by hand"]),
    ({"COMPASS_AUTODEC": 0.0}, 1, ["a declination of 0.0 deg"]),
]
PX4: list[tuple[dict[str, float], int, list[str]]] = [
    ({}, 1, []),
    ({"CAL_MAG0_PRIO": 0.0}, 1, ["CAL_MAG0_PRIO is 0"]),
    ({"CAL_MAG0_PRIO": 0.0}, 2, []),
    ({"SENS_MAG_AUTOCAL": 1.0}, 1, []),  # PX4's default: what has a calibration keeps it
    ({"CAL_MAG0_ID": 0.0}, 1, ["CAL_MAG0_ID is 0"]),
    ({"CAL_MAG0_ID": 7.0, "CAL_MAG1_ID": 7.0}, 1, ["the same device id"]),
    ({"EKF2_GPS_CTRL": 15.0}, 1, ["satellite receivers (EKF2_GPS_CTRL is 15)"]),
    ({"EKF2_MAG_TYPE": 5.0}, 1, ["EKF2_MAG_TYPE is 5"]),
]


@pytest.mark.parametrize(
    ("autopilot", "parameters", "instance", "words"),
    [("ardupilot", *row) for row in ARDUPILOT] + [("px4", *row) for row in PX4],
)
def test_what_is_remarked(
    autopilot: str, parameters: dict[str, float], instance: int, words: list[str]
) -> None:
    said = parameter_remarks(autopilot, parameters, instance)
    assert len(said) == len(words)
    assert all(part in remark.text for part, remark in zip(words, said, strict=True))
    forbidding = ("switched off: set", "in-flight learning")
    assert all(remark.forbids == any(w in remark.text for w in forbidding) for remark in said)


def test_what_is_true_of_all_compasses_is_said_once() -> None:
    assert len(remarks_said("ardupilot", {"COMPASS_AUTODEC": 0.0}, 1, 2, 3)) == 1
    assert len(remarks_said("px4", {"CAL_MAG1_ID": 7.0, "CAL_MAG2_ID": 7.0, "EKF2_MAG_TYPE": 5.0}, 2, 3)) == 2


@pytest.mark.parametrize(
    ("autopilot", "parameters", "reporting", "has"),
    [
        ("ardupilot", {"COMPASS_OFS_X": 1.0, "COMPASS_OFS2_X": 0.0, **TWO}, (), (1, 2)),
        ("ardupilot", {"COMPASS_OFS_X": 1.0, "COMPASS_OFS2_X": 0.0}, (), (1, 2)),
        ("ardupilot", {"COMPASS_OFS_X": 1.0, "COMPASS_DEV_ID": 0.0}, (), ()),
        ("ardupilot", {"COMPASS_OFS_X": 1.0, "COMPASS_DEV_ID": 0.0}, (1,), (1,)),
        ("ardupilot", {"COMPASS_OFS_X": 1.0, "COMPASS_DEV_ID": 5.0}, (2,), (1, 2)),
        ("px4", {"CAL_MAG0_ID": 0.0, "CAL_MAG1_ID": 5.0}, (), (2,)),
        ("px4", {"CAL_MAG0_ID": 0.0}, (1,), (1,)),
        ("px4", {}, (2, 1), (1, 2)),
    ],
)
def test_a_compass_is_there_by_its_id_or_by_its_readings(
    autopilot: str, parameters: dict[str, float], reporting: tuple[int, ...], has: tuple[int, ...]
) -> None:
    assert compasses_of(autopilot, parameters, reporting) == has
