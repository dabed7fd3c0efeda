"""Angles and rotations: closed forms, and the properties that every rotation has."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.frames import (
    SENSOR_ORIENTATIONS_DEG,
    circular_mean,
    euler_to_matrix,
    euler_to_quaternion,
    matrix_to_euler,
    quaternion_to_matrix,
    rotate,
    rotate_back,
    sensor_orientation_matrix,
    tilt_from_acceleration,
    wrap_pi,
    wrap_two_pi,
)

angles = st.floats(-3.0, 3.0)
tilts = st.floats(-1.4, 1.4)


def test_yaw_turns_the_nose_from_north_to_east() -> None:
    nose = rotate(euler_to_matrix(0.0, 0.0, math.pi / 2), [1.0, 0.0, 0.0])
    assert nose == pytest.approx([0.0, 1.0, 0.0])


def test_positive_pitch_lifts_the_nose_and_positive_roll_lowers_the_right_wing() -> None:
    assert rotate(euler_to_matrix(0.0, 0.1, 0.0), [1.0, 0.0, 0.0])[2] == pytest.approx(-math.sin(0.1))
    assert rotate(euler_to_matrix(0.1, 0.0, 0.0), [0.0, 1.0, 0.0])[2] == pytest.approx(math.sin(0.1))


@given(tilts, tilts, angles)
def test_euler_angles_survive_the_matrix_and_the_quaternion(roll: float, pitch: float, yaw: float) -> None:
    matrix = euler_to_matrix(roll, pitch, yaw)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert [float(a) for a in matrix_to_euler(matrix)] == pytest.approx([roll, pitch, yaw], abs=1e-9)
    assert quaternion_to_matrix(euler_to_quaternion(roll, pitch, yaw)) == pytest.approx(matrix, abs=1e-12)


@given(tilts, tilts, angles)
def test_rotating_back_undoes_rotating(roll: float, pitch: float, yaw: float) -> None:
    matrix = euler_to_matrix(roll, pitch, yaw)
    vector = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])
    assert rotate_back(matrix, rotate(matrix, vector)) == pytest.approx(vector, abs=1e-12)


@given(tilts, tilts, angles)
def test_a_vehicle_at_rest_shows_its_tilt_to_the_accelerometer(roll: float, pitch: float, yaw: float) -> None:
    specific_force = rotate_back(euler_to_matrix(roll, pitch, yaw), [0.0, 0.0, -9.8])
    assert [float(a) for a in tilt_from_acceleration(specific_force)] == pytest.approx(
        [roll, pitch], abs=1e-9
    )


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_point_the_same_way(angle: float) -> None:
    assert -math.pi <= wrap_pi(angle) < math.pi
    assert 0.0 <= wrap_two_pi(angle) < 2 * math.pi
    for wrapped in (wrap_pi(angle), wrap_two_pi(angle)):
        assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
        assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_the_mean_of_350_and_10_degrees_is_north() -> None:
    assert circular_mean(np.radians([350.0, 10.0])) == pytest.approx(0.0, abs=1e-12)


def test_sensor_orientations_are_those_of_the_dialect() -> None:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    words = {
        number: entry.name.removeprefix("MAV_SENSOR_ROTATION_")
        for number, entry in dialect.enums["MAV_SENSOR_ORIENTATION"].items()
        if entry.name.startswith("MAV_SENSOR_ROTATION_") and "CUSTOM" not in entry.name
    }
    for number, name in words.items():
        if number not in SENSOR_ORIENTATIONS_DEG:
            continue
        wanted = dict.fromkeys(("ROLL", "PITCH", "YAW"), 0.0)
        parts = [] if name == "NONE" else name.split("_")
        for axis, degrees in zip(parts[::2], parts[1::2], strict=True):
            wanted[axis] = float(degrees)
        assert SENSOR_ORIENTATIONS_DEG[number] == tuple(wanted.values()), name
    assert set(words) - set(SENSOR_ORIENTATIONS_DEG) == set()


def test_every_sensor_orientation_is_a_rotation() -> None:
    for number in SENSOR_ORIENTATIONS_DEG:
        matrix = sensor_orientation_matrix(number)
        assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(matrix) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("number", "roll_pitch_yaw_deg"), [(41, (0.0, 7.0, 0.0)), (42, (45.0, 0.0, 0.0)), (43, (315.0, 0.0, 0.0))]
)
def test_sensor_orientations_that_only_ardupilot_has(
    number: int, roll_pitch_yaw_deg: tuple[float, float, float]
) -> None:
    """ROTATION_PITCH_7, ROTATION_ROLL_45 and ROTATION_ROLL_315 of its AP_Math/rotations.h."""
    assert SENSOR_ORIENTATIONS_DEG[number] == roll_pitch_yaw_deg
    assert sorted(SENSOR_ORIENTATIONS_DEG) == list(range(44))


def test_the_edges_of_the_circle() -> None:
    assert wrap_pi(math.pi) == wrap_pi(-math.pi) == -math.pi
    assert wrap_two_pi(2.0 * math.pi) == wrap_two_pi(-1e-17) == 0.0
    assert math.isnan(circular_mean([])) and circular_mean([0.0]) == 0.0
    assert [float(angle) for angle in matrix_to_euler(euler_to_matrix(0.0, math.pi / 2, 0.3))][
        1
    ] == math.pi / 2
