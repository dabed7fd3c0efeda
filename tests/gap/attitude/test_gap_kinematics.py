"""Rotations that the attitude is made of, turns about a known down, and who steers the autopilot's yaw."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from mavcompass.frames import FloatArray, euler_to_matrix, matrix_to_rotvec, rotvec_to_matrix
from mavcompass.gap.attitude.kinematics import with_down
from mavcompass.gap.attitude.reference import Steering, body_rate, steered_by
from mavcompass.track import Track


@pytest.mark.parametrize(("instance", "said"), [(1, "own"), (2, "other")])
def test_parameters_tell_which_compass_steers(instance: int, said: Steering) -> None:
    track = Track(compasses={}, autopilot="ardupilot", parameters={"COMPASS_USE": 1.0})
    assert steered_by(track, instance) == said
    assert steered_by(Track(compasses={}), instance) == "unknown"


def tumbling(seed: int) -> tuple[FloatArray, FloatArray]:
    """Return times and rotations of a vehicle that pitches straight up and over, and rolls and turns."""
    t = np.arange(0.0, 40.0, 0.02)
    rng = np.random.default_rng(seed)
    roll = 0.4 * np.sin(0.7 * t + rng.uniform(0.0, 6.0))
    return t, euler_to_matrix(roll, 0.5 * t, 0.8 * np.sin(0.5 * t) + 0.1 * t)


@pytest.mark.parametrize("seed", [0, 1])
def test_known_down_is_kept_and_the_yaw_turns_as_the_gyro_does_through_straight_up(seed: int) -> None:
    t, truth = tumbling(seed)
    assert np.abs(truth[:, 2, 0]).max() > 0.999
    rate = body_rate(t, truth) + np.array([0.004, -0.006, 0.005])
    down = truth[:, 2]
    found = with_down(t, rate, down)
    np.testing.assert_array_equal(found[:, 2], down)
    np.testing.assert_allclose(
        found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (t.size, 1, 1)), atol=1e-9
    )
    about = np.einsum("ni,ni->n", body_rate(t, found), down)
    asked = np.einsum("ni,ni->n", rate, down)
    assert np.abs(about - asked)[3:-3].max() < 1e-4


def test_true_rates_and_down_give_the_true_attitude_but_for_the_first_yaw() -> None:
    t, truth = tumbling(2)
    found = with_down(t, body_rate(t, truth), truth[:, 2])
    apart = truth @ found.transpose(0, 2, 1)
    np.testing.assert_allclose(apart, np.tile(apart[0], (t.size, 1, 1)), atol=1e-3)
    np.testing.assert_allclose(apart[0][2], [0.0, 0.0, 1.0], atol=1e-9)


def test_rotvec_to_matrix_are_scipys_rotations_and_their_vectors_come_back() -> None:
    vectors = np.random.default_rng(4).uniform(-1.5, 1.5, (200, 3))
    vectors[:3] = [[0.0, 0.0, 0.0], [1e-12, 0.0, 0.0], [1e-5, -1e-5, 0.0]]
    rotations = rotvec_to_matrix(vectors)
    theirs = scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotations, theirs, atol=1e-12)
    np.testing.assert_allclose(matrix_to_rotvec(rotations), vectors, atol=1e-9)
