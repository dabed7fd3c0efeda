"""How a compass is mounted, in the autopilots' parameters: read as the firmware does, spelled, turned."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mavcompass.compass_parameters import (
    ardupilot_correction,
    ardupilot_name,
    mounting_values,
    px4_correction,
    sensor_to_body,
    values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.frames import NUMBERED_WITHIN_RAD, FloatArray, angle_between, rotation_of

ARDUPILOT = {"COMPASS_EXTERNAL": 1.0, "COMPASS_ORIENT": 0.0, "CUST_ROT_ENABLE": 0.0}
BEFORE_4_2 = {"COMPASS_EXTERNAL": 1.0, "COMPASS_ORIENT": 0.0, "COMPASS_CUS_ROLL": 0.0}
PX4 = {"CAL_MAG0_ROT": 0.0, "CAL_MAG0_ROLL": 0.0, "CAL_MAG0_PITCH": 0.0, "CAL_MAG0_YAW": 0.0}
READ = {"ardupilot": ardupilot_correction, "px4": px4_correction}

angles = st.one_of(st.floats(-180.0, 180.0), st.sampled_from([-180.0, -90.0, 0.0, 90.0, 135.0]))
pitches = st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, 90.0, 89.9999999]))
rotations = st.builds(lambda *rpy: rotation_of(rpy), angles, pitches, angles)
corrections = st.builds(
    FieldCorrection,
    st.tuples(*[st.floats(-700, 700)] * 3),
    st.tuples(*[st.floats(0.6, 1.6)] * 3),
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.floats(0.7, 1.4),
    st.tuples(*[st.floats(-20, 20)] * 3),
    st.just("current"),
)


def about(axis: int, degrees: float) -> FloatArray:
    """Turn about one axis by the right hand."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = c
    matrix[first, second], matrix[second, first] = -s, s
    return matrix


TURNED = about(2, 30.0) @ about(1, -20.0) @ about(0, 10.0)  # yaw after pitch after roll
ANGLES = (10.0, -20.0, 30.0)


@pytest.mark.parametrize(
    ("autopilot", "parameters", "expected"),
    [
        ("ardupilot", {"COMPASS_EXTERNAL": 1, "COMPASS_ORIENT": 2}, about(2, 90.0)),
        ("ardupilot", {"COMPASS1_EXTERN": 1, "COMPASS1_ORIENT": 16, "COMPASS1_OFS_X": 0}, about(0, 90.0)),
        ("ardupilot", {"COMPASS_EXTERNAL": 0, "COMPASS_ORIENT": 2}, np.eye(3)),
        ("ardupilot", {"COMPASS_EXTERNAL": 0, "COMPASS_ORIENT": 2, "AHRS_ORIENTATION": 24}, about(1, 90.0)),
        ("ardupilot", {"COMPASS_EXTERNAL": 2, "COMPASS_ORIENT": 99, "AHRS_ORIENTATION": 24}, np.eye(3)),
        ("ardupilot", ARDUPILOT | {"COMPASS_ORIENT": 101, "CUST_ROT1_YAW": 5.0}, about(2, 5.0)),
        ("ardupilot", ARDUPILOT | {"COMPASS_ORIENT": 102, "CUST_ROT1_YAW": 5.0}, np.eye(3)),
        ("ardupilot", BEFORE_4_2 | {"COMPASS_ORIENT": 100, "COMPASS_CUS_PIT": 7.0}, about(1, 7.0)),
        ("ardupilot", ARDUPILOT | {"COMPASS_ORIENT": 100, "COMPASS_CUS_PIT": 7.0}, np.eye(3)),
        ("ardupilot", {"AHRS_ORIENTATION": 100, "AHRS_CUSTOM_ROLL": 3.0}, about(0, 3.0)),
        ("ardupilot", {"AHRS_ORIENTATION": 101, "CUST_ROT_ENABLE": 1, "CUST_ROT1_ROLL": 3.0}, about(0, 3.0)),
        ("px4", {"CAL_MAG0_ROT": 2}, about(2, 90.0)),
        ("px4", {"CAL_MAG0_ROT": -1, "SENS_BOARD_ROT": 24}, about(1, 90.0)),
        ("px4", {"SENS_BOARD_ROT": 2, "SENS_BOARD_X_OFF": 4.0}, about(0, 4.0) @ about(2, 90.0)),
        ("px4", {"CAL_MAG0_ROT": 2, "SENS_BOARD_Y_OFF": 4.0}, about(1, 4.0) @ about(2, 90.0)),
        ("px4", {"CAL_MAG0_ROT": 100, "CAL_MAG0_YAW": 5.0, "SENS_BOARD_ROT": 2}, about(2, 5.0)),
        ("px4", {"CAL_MAG0_ROT": 2, "CAL_MAG0_YAW": 5.0}, about(2, 5.0)),  # which makes it 100
        ("px4", {"CAL_MAG0_ROT": -1, "CAL_MAG0_YAW": 5.0}, np.eye(3)),
        ("px4", {"CAL_MAG0_ROT": 41}, about(2, 180.0) @ about(0, 270.0)),  # PX4's own until 1.11
        ("px4", {"CAL_MAG0_ROT": 77}, np.eye(3)),
    ],
)
def test_a_mounting_is_read_as_the_firmware_takes_it(
    autopilot: str, parameters: dict[str, float], expected: FloatArray
) -> None:
    assert sensor_to_body(autopilot, parameters, 1) == pytest.approx(expected, abs=1e-12)


def test_the_order_of_free_angles_is_roll_first() -> None:
    free = dict(zip(("CUST_ROT2_ROLL", "CUST_ROT2_PITCH", "CUST_ROT2_YAW"), ANGLES, strict=True))
    held = ARDUPILOT | free | {"COMPASS_ORIENT": 102.0}
    assert sensor_to_body("ardupilot", held, 1) == pytest.approx(TURNED, abs=1e-12)
    free = dict(zip(("CAL_MAG0_ROLL", "CAL_MAG0_PITCH", "CAL_MAG0_YAW"), ANGLES, strict=True))
    assert sensor_to_body("px4", free | {"CAL_MAG0_ROT": 100.0}, 1) == pytest.approx(TURNED, abs=1e-12)


def test_ardupilots_orientation_38_is_what_the_firmwares_own_test_has() -> None:
    """Roll 90, pitch 68.8, yaw 293.3, unlike its name (AP_Math/tests/test_math.cpp)."""
    turned = sensor_to_body("ardupilot", ARDUPILOT | {"COMPASS_ORIENT": 38.0}, 1) @ np.ones(3)
    assert turned == pytest.approx([-0.40663092252, -1.58396771826, -0.57069923113], abs=1e-7)


def test_a_mounting_within_half_a_degree_of_a_number_is_that_number() -> None:
    near, far = about(0, 0.45) @ about(2, 90.0), about(0, 0.55) @ about(2, 90.0)
    assert mounting_values("ardupilot", ARDUPILOT, 1, near) == {"COMPASS_ORIENT": 2.0}
    assert mounting_values("ardupilot", ARDUPILOT, 1, far)["COMPASS_ORIENT"] == 101.0
    # PX4 would make the number 100 again if an angle stayed.
    assert mounting_values("px4", PX4 | {"CAL_MAG0_YAW": 9.0}, 1, near) == PX4 | {"CAL_MAG0_ROT": 2.0}
    assert mounting_values("px4", PX4, 1, far)["CAL_MAG0_ROT"] == 100.0
    assert mounting_values("px4", {"CAL_MAG0_ROT": 0.0}, 1, near) == {"CAL_MAG0_ROT": 2.0}


@given(rotations, st.sampled_from([ARDUPILOT, BEFORE_4_2, PX4]), st.floats(-5.0, 5.0))
def test_what_is_spelled_is_what_is_read(
    rotation: FloatArray, held: dict[str, float], level_deg: float
) -> None:
    autopilot = "px4" if held is PX4 else "ardupilot"
    held = held | {"SENS_BOARD_X_OFF": level_deg}
    spelled = mounting_values(autopilot, held, 1, rotation)
    after = sensor_to_body(autopilot, held | single(spelled), 1)
    numbered = spelled.get("CAL_MAG0_ROT", spelled.get("COMPASS_ORIENT", 0.0)) < 100.0
    assert angle_between(after, rotation) < (NUMBERED_WITHIN_RAD + 1e-9 if numbered else 1e-6)


def single(spelled: dict[str, float]) -> dict[str, float]:
    return {name: float(np.float32(value)) for name, value in spelled.items()}


def three_compasses(orientations: tuple[int, int, int], free: list[float], board: int) -> dict[str, float]:
    names = [f"CUST_ROT{n}_{angle}" for n in (1, 2) for angle in ("ROLL", "PITCH", "YAW")]
    held = {"CUST_ROT_ENABLE": 1.0, "AHRS_ORIENTATION": float(board), **dict(zip(names, free, strict=True))}
    for i, number in enumerate(orientations, start=1):
        held |= {ardupilot_name("EXTERNAL", i): 1.0, ardupilot_name("ORIENT", i): float(number)}
    return held


@given(
    rotations,
    st.tuples(*[st.sampled_from([0, 4, 101, 102])] * 3),
    st.lists(st.sampled_from([0.0, 33.0]), min_size=6, max_size=6),
    st.sampled_from([0, 101, 102]),
)
def test_free_angles_that_something_else_uses_are_left_alone(
    rotation: FloatArray, orientations: tuple[int, int, int], free: list[float], board: int
) -> None:
    held = three_compasses(orientations, free, board) | {"COMPASS_EXTERN3": 0.0}
    try:
        after = held | mounting_values("ardupilot", held, 1, rotation)
    except Refused as refusal:
        assert "no free angles left" in str(refusal)
        used = {*orientations[1:2], board}
        assert all(slot in used or any(free[3 * n : 3 * n + 3]) for n, slot in enumerate((101, 102)))
        return
    for other in (2, 3):
        assert np.array_equal(
            sensor_to_body("ardupilot", after, other), sensor_to_body("ardupilot", held, other)
        )
    assert angle_between(sensor_to_body("ardupilot", after, 1), rotation) <= NUMBERED_WITHIN_RAD + 1e-9


@pytest.mark.parametrize(
    ("autopilot", "held", "words"),
    [
        (
            "ardupilot",
            ARDUPILOT | {"COMPASS_EXTERNAL": 0.0},
            "COMPASS_ORIENT is not for it.*AHRS_ORIENTATION",
        ),
        ("ardupilot", {"COMPASS_EXTERNAL": 1.0}, "roll 10.0, pitch -20.0, yaw 30.0.*knows no free angles"),
        ("px4", PX4 | {"CAL_MAG0_ROT": -1.0}, "inside the flight controller.*SENS_BOARD_ROT"),
        ("px4", {"CAL_MAG0_ROT": 0.0}, "before 1.15.*nearest one, 1, is .* degrees off"),
    ],
)
def test_a_mounting_that_cannot_be_set_is_refused_with_what_to_do(
    autopilot: str, held: dict[str, float], words: str
) -> None:
    with pytest.raises(Refused, match=words):
        mounting_values(autopilot, held, 1, TURNED)


@given(corrections, rotations, st.sampled_from(["ardupilot", "px4"]), st.floats(0.0, 30.0), st.booleans())
def test_turning_a_compass_turns_the_field_that_it_shows(
    correction: FieldCorrection, turned: FloatArray, autopilot: str, current_a: float, told: bool
) -> None:
    """The correction in force, turned with the compass, makes of the same reading the turned field."""
    held = PX4 | {"CAL_MAG_COMP_TYP": 2.0, "CAL_MAG0_XCOMP": 0.3} if autopilot == "px4" else ARDUPILOT
    held = held | values(autopilot, held, 1, correction)
    before, mounted = READ[autopilot](held, 1), sensor_to_body(autopilot, held, 1)
    wanted = before.turned(turned)
    if not told:  # a motor term that a new calibration does not have stays the compass's
        wanted = FieldCorrection.from_matrix(wanted.offsets_mgauss, wanted.matrix)
    held |= values(autopilot, held, 1, wanted, turned)
    after, now = READ[autopilot](held, 1), sensor_to_body(autopilot, held, 1)
    assume(angle_between(now, turned @ mounted) < 1e-6)  # not a number half a degree off
    raw_sensor = np.array([120.0, -230.0, 410.0])
    field, field_before = (
        after.apply(now @ raw_sensor, current_a),
        before.apply(mounted @ raw_sensor, current_a),
    )
    assert field == pytest.approx(turned @ field_before, abs=1e-3)
