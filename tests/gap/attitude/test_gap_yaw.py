"""The age of a rate beside another yaw, who steers the autopilot's yaw, and turns about a known down."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.attitude.kinematics import with_down
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.attitude.steering import Steering, age_of, steered_by
from mavcompass.gap.trial.vehicles.motion import move
from mavcompass.track import Track


def found_age(name: str, bent_deg: float, age_s: float, seed: int) -> float | None:
    """Return the age that is found of a rover's late gyro beside a yaw that bends with the heading."""
    motion = move("rover", name, 120.0, np.random.default_rng(seed))
    yaw = np.unwrap(np.arctan2(motion.rotation[:, 1, 0], motion.rotation[:, 0, 0]))
    clock = np.arange(motion.time_s[0] + 0.2, motion.time_s[-1] - 0.2, 0.04)
    late = np.interp(clock - age_s, motion.time_s, yaw)
    rate = np.gradient(late, clock) + np.random.default_rng([seed, 6]).normal(0.0, 0.003, clock.size)
    when = clock[::2]
    true = np.interp(when, motion.time_s, yaw)
    bent = true + math.radians(bent_deg) * np.sin(true + 1.5 * seed)
    return age_of(clock, rate, when, bent)


@pytest.mark.parametrize("name", ["lanes", "figure_eight", "circles", "four_positions", "pirouette"])
@pytest.mark.parametrize("bent_deg", [0.0, 20.0])
@pytest.mark.parametrize("age_s", [0.06, -0.08])
def test_age_of_a_gyro_is_found_beside_a_bent_yaw(name: str, bent_deg: float, age_s: float) -> None:
    for seed in range(3):
        assert found_age(name, bent_deg, age_s, seed) == pytest.approx(age_s, abs=0.0101)


def test_age_of_a_gyro_is_found_in_slow_smooth_turns() -> None:
    for seed in range(3):
        assert found_age("hand", 0.0, 0.06, seed) == pytest.approx(0.06, abs=0.0101)


def test_age_of_a_gyro_is_found_beside_a_bent_yaw_in_slow_smooth_turns() -> None:
    for seed in range(3):
        assert found_age("hand", 20.0, 0.06, seed) == pytest.approx(0.06, abs=0.0201)


def test_age_is_not_told_by_what_hardly_turns_or_lasts_briefly() -> None:
    clock = np.arange(0.0, 60.0, 0.04)
    yaw = 0.01 * np.sin(clock)
    assert age_of(clock, np.gradient(yaw, clock), clock, yaw) is None
    # On a circle every age explains as much.
    for seed in range(6):
        rng = np.random.default_rng(seed)
        circled = 0.5 * clock + 0.02 * np.cumsum(rng.normal(0.0, 0.2, clock.size)) * 0.04
        assert age_of(clock, 0.5 + rng.normal(0.0, 0.003, clock.size), clock, circled) is None
    short = clock[:80]
    assert age_of(short, np.cos(short), short, np.sin(short)) is None


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
