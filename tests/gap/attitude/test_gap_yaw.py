"""The smoothed yaw against what was put in, the age of a rate, and who steers the autopilot's yaw."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.attitude.kinematics import with_down
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.attitude.steering import Steering, steered_by
from mavcompass.gap.attitude.yaw import Witness, YawError, age_of, smoothed
from mavcompass.gap.trial.vehicles.motion import move
from mavcompass.track import Track

CLOCK = np.arange(0.0, 120.0, 0.1)
WITNESSED = np.arange(0.0, 119.0, 1.0)
DRIFT, WANDER = math.radians(0.2), math.radians(0.01)
MEMORY_S, LASTING, SCATTER = 8.0, math.radians(1.6), math.radians(0.1)
UNKNOWN = math.radians(60.0)


def turns(rng: np.random.Generator, clock: FloatArray = CLOCK) -> FloatArray:
    """Return a yaw that goes to and fro."""
    periods, phases = rng.uniform(12.0, 40.0, 3), rng.uniform(0.0, 6.0, 3)
    return np.asarray(np.sin(2.0 * np.pi * clock[:, None] / periods + phases).sum(axis=1))


def gyro_error(rng: np.random.Generator, yaw: FloatArray) -> FloatArray:
    """Return what the integral lacks: drift, scale, age, and the integral of a bias that wanders."""
    step = CLOCK[1] - CLOCK[0]
    bias = np.cumsum(rng.standard_normal(CLOCK.size)) * WANDER * math.sqrt(step)
    late = rng.normal(0.0, 0.1) * np.gradient(yaw, CLOCK)
    return rng.normal(0.0, DRIFT) * CLOCK + rng.normal(0.0, 0.01) * yaw + late + np.cumsum(bias) * step


def witness_error(rng: np.random.Generator) -> FloatArray:
    """Return an error that lasts for some seconds, and white scatter."""
    kept = math.exp(-1.0 / MEMORY_S)
    error = np.empty(WITNESSED.size)
    error[0] = rng.normal(0.0, LASTING)
    for i in range(1, error.size):
        error[i] = kept * error[i - 1] + rng.normal(0.0, LASTING * math.sqrt(1.0 - kept**2))
    return error + rng.normal(0.0, SCATTER, error.size)


def witness(ahead: FloatArray, constant: float = math.radians(3.0)) -> Witness:
    return Witness(WITNESSED, ahead, constant, SCATTER, MEMORY_S)


def wanders(values: FloatArray) -> float:
    """Return the rms about the mean: the constant is told apart."""
    return float(np.std(values))


def drawn(seed: int) -> tuple[FloatArray, FloatArray, YawError]:
    rng = np.random.default_rng([seed, 11])
    yaw = turns(rng)
    error, other = gyro_error(rng, yaw), witness_error(rng)
    ahead = np.interp(WITNESSED, CLOCK, error) + rng.normal(0.0, math.radians(3.0)) + other
    return error, other, smoothed(CLOCK, yaw, DRIFT, [witness(ahead)], UNKNOWN)


def test_smoothed_yaw_is_better_than_either_source_and_knows_how_good_it_is() -> None:
    inside, left, gyro, other = [], [], [], []
    places = np.linspace(0, CLOCK.size - 1, 12).astype(int)
    for seed in range(200):
        error, n, found = drawn(seed)
        off = error - found.mean_rad
        off -= off.mean()
        sigma = np.sqrt((found.curves_rad**2).sum(axis=1))
        inside.append(np.abs(off[places]) < sigma[places])
        left.append(wanders(off))
        gyro.append(wanders(error))
        other.append(wanders(n))
    rms = [float(np.sqrt(np.mean(np.square(x)))) for x in (left, gyro, other)]
    assert rms[0] < 0.2 * rms[1] and rms[0] < 0.7 * rms[2]
    assert np.mean(np.array(left) < np.array(other)) > 0.9
    assert 0.60 < np.mean(inside) < 0.76


def test_without_a_witness_nothing_is_corrected_and_the_drift_stays_open() -> None:
    yaw = turns(np.random.default_rng(1))
    found = smoothed(CLOCK, yaw, DRIFT, [], UNKNOWN)
    assert not found.mean_rad.any() and found.constant_sigma_rad == UNKNOWN
    sigma = np.sqrt((found.curves_rad**2).sum(axis=1))
    # At the ends the drift alone is off by half of the recording's length.
    assert sigma[0] > 0.95 * DRIFT * 0.5 * (CLOCK[-1] - CLOCK[0])


def test_constant_of_an_independent_witness_comes_through() -> None:
    rng = np.random.default_rng(2)
    yaw = turns(rng)
    ahead = math.radians(20.0) + 0.1 * witness_error(rng)
    found = smoothed(CLOCK, yaw, DRIFT, [witness(ahead, math.radians(1.0))], UNKNOWN)
    assert math.degrees(float(found.mean_rad.mean())) == pytest.approx(20.0, abs=0.3)
    assert found.constant_sigma_rad == math.radians(1.0)


def test_the_surer_of_two_witnesses_gives_the_constant_in_either_order() -> None:
    rng = np.random.default_rng(3)
    yaw, n = turns(rng), 0.1 * witness_error(rng)
    sure, vague = witness(0.3 + n, math.radians(1.0)), witness(0.5 + n, math.radians(3.0))
    for both in ([sure, vague], [vague, sure]):
        found = smoothed(CLOCK, yaw, DRIFT, both, UNKNOWN)
        assert float(found.mean_rad.mean()) == pytest.approx(0.3, abs=0.01)
        assert found.constant_sigma_rad == math.radians(1.0)


def test_known_age_alone_moves_the_yaw_by_what_it_turns_meanwhile() -> None:
    yaw = turns(np.random.default_rng(4))
    found = smoothed(CLOCK, yaw, DRIFT, [], UNKNOWN, age_s=0.06)
    turned = 0.06 * np.gradient(yaw, CLOCK)
    np.testing.assert_allclose(found.mean_rad, turned - turned.mean(), atol=1e-9)


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
    short = clock[:80]
    assert age_of(short, np.cos(short), short, np.sin(short)) is None


ARDUPILOT: list[tuple[dict[str, float], int, Steering]] = [
    ({}, 1, "unknown"),
    ({"COMPASS_USE": 1.0}, 1, "own"),
    ({"COMPASS_USE": 1.0}, 2, "unknown"),
    ({"COMPASS_USE": 1.0, "COMPASS_USE2": 1.0, "COMPASS_USE3": 1.0}, 1, "own"),
    ({"COMPASS_USE": 1.0, "COMPASS_USE2": 1.0}, 2, "other"),
    ({"COMPASS_USE": 0.0, "COMPASS_USE2": 1.0}, 1, "other"),
    ({"COMPASS_USE": 0.0, "COMPASS_USE2": 1.0}, 2, "own"),
    ({"COMPASS_USE": 0.0, "COMPASS_USE2": 0.0, "COMPASS_USE3": 1.0}, 3, "own"),
    ({"COMPASS_USE": 1.0, "EK3_SRC1_YAW": 1.0}, 1, "own"),
    *(({"COMPASS_USE": 1.0, "EK3_SRC1_YAW": source}, 1, "other") for source in (2.0, 3.0, 6.0, 8.0)),
]
PX4: list[tuple[dict[str, float], int, Steering]] = [
    ({}, 1, "unknown"),
    ({"CAL_MAG0_PRIO": 50.0}, 1, "own"),
    ({"CAL_MAG0_PRIO": 50.0}, 2, "unknown"),
    ({"CAL_MAG0_PRIO": 75.0, "CAL_MAG1_PRIO": 50.0}, 1, "own"),
    ({"CAL_MAG0_PRIO": 75.0, "CAL_MAG1_PRIO": 50.0}, 2, "other"),
    ({"CAL_MAG0_PRIO": 50.0, "CAL_MAG1_PRIO": 50.0}, 1, "unknown"),
    ({"CAL_MAG0_PRIO": 0.0, "CAL_MAG1_PRIO": 50.0}, 1, "other"),
    ({"CAL_MAG0_PRIO": 50.0, "CAL_MAG3_PRIO": 75.0}, 4, "own"),
    ({"CAL_MAG0_PRIO": 50.0, "EKF2_MAG_TYPE": 5.0}, 1, "other"),
    ({"CAL_MAG0_PRIO": 50.0, "EKF2_MAG_TYPE": 0.0}, 1, "own"),
]


@pytest.mark.parametrize(
    ("autopilot", "parameters", "instance", "said"),
    [("ardupilot", *row) for row in ARDUPILOT] + [("px4", *row) for row in PX4],
)
def test_parameters_tell_which_compass_steers(
    autopilot: str, parameters: dict[str, float], instance: int, said: Steering
) -> None:
    track = Track(compasses={}, autopilot=autopilot, parameters=parameters)
    assert steered_by(track, instance) == said


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
