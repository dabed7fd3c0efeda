"""The attitude that gyro, accelerometer and receiver give, against motions whose attitude is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.frames import (
    FloatArray,
    euler_to_matrix,
    matrix_to_euler,
    rotate,
    rotate_back,
    rotvec_to_matrix,
)
from mavcompass.gap.attitude.kinematics import integrated, products
from mavcompass.gap.attitude.reference import body_rate, reference_attitude
from mavcompass.gap.attitude.sensors import bias_at_rest, local_position
from mavcompass.gap.trial.cases import Recipe, make_track, stimulus_of
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

_STEP_S = 0.04


def times(duration_s: float) -> FloatArray:
    return np.arange(0.0, duration_s, _STEP_S)


def recorded(
    t: FloatArray,
    rotation: FloatArray,
    acceleration: FloatArray,
    *,
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0),
    path: FloatArray | None = None,
    seed: int = 1,
) -> Track:
    """Record noisy gyro and accelerometer, and positions (N, 3) five times a second with slow errors."""
    rng = np.random.default_rng(seed)
    force = rotate_back(rotation, acceleration - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    gyro = body_rate(t, rotation) + np.array(bias) + 0.002 * rng.standard_normal((t.size, 3))
    acc = force + 0.1 * rng.standard_normal((t.size, 3))
    position = None
    if path is not None:
        heard = slice(None, None, 5)
        wander = np.convolve(rng.standard_normal(t[heard].size), np.ones(5) / 5.0, mode="same")
        position = Series.of(t[heard], path[heard] + 0.3 * wander[:, None])
    return Track(gyro_radps=Series.of(t, gyro), acc_mps2=Series.of(t, acc), position_ned_m=position)


def tilt_rms_deg(track: Track, rotation: FloatArray) -> float:
    assert track.gyro_radps is not None
    found = reference_attitude(track, track.gyro_radps.time_s)
    off = found.rotation[:, 2] - rotation[:, 2]
    return math.degrees(math.sqrt(float(np.mean(np.sum(off**2, axis=1)))))


def circling(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive circles from the first to the last sample: attitude, acceleration and path."""
    speed, turn = 2.0, 0.3
    yaw = turn * t
    rotation = euler_to_matrix(0.02 * np.sin(0.9 * t), 0.015 * np.sin(0.7 * t), yaw)
    nothing = np.zeros_like(t)
    acceleration = speed * turn * np.stack([-np.sin(yaw), np.cos(yaw), nothing], axis=1)
    path = speed / turn * np.stack([np.sin(yaw), 1.0 - np.cos(yaw), nothing], axis=1)
    return rotation, acceleration, path


def leaning(t: FloatArray, degrees: float) -> tuple[FloatArray, FloatArray]:
    """Fly about as a copter does, pushed by its lean alone: attitude and acceleration."""
    roll = math.radians(degrees) * np.sin(0.7 * t) * np.sin(0.11 * t)
    pitch = math.radians(degrees) * np.sin(0.5 * t + 1.0) * np.sin(0.13 * t)
    rotation = euler_to_matrix(roll, pitch, 0.8 * np.sin(0.2 * t))
    thrust = -rotation[:, :, 2] * (STANDARD_GRAVITY_MPS2 / rotation[:, 2, 2])[:, None]
    return rotation, thrust + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])


def test_receiver_tells_a_turns_pull_from_a_tilt() -> None:
    t = times(90.0)
    rotation, acceleration, path = circling(t)
    # 2 m/s at 0.3 rad/s pull like a tilt of 3.5 degrees.
    assert tilt_rms_deg(recorded(t, rotation, acceleration, path=path), rotation) < 0.4


@pytest.mark.parametrize("seed", [1, 2])
def test_copter_that_never_rests_is_levelled(seed: int) -> None:
    t = times(120.0)
    rotation, acceleration = leaning(t, 18.0)
    track = recorded(t, rotation, acceleration, bias=(0.002, -0.001, 0.001), seed=seed)
    assert tilt_rms_deg(track, rotation) < 0.7


@pytest.mark.parametrize("bent_deg", [0.0, 90.0, -135.0])
def test_autopilot_that_leans_by_a_bent_yaw_does_not_tilt_what_the_receiver_levels(bent_deg: float) -> None:
    """Its filter turns what the receiver tells into wrong axes, and takes the rest for gravity."""
    t = times(120.0)
    rotation, acceleration = leaning(t, 12.0)
    acceleration = acceleration - acceleration.mean(axis=0)
    velocity = np.cumsum(acceleration, axis=0) * _STEP_S
    path = np.cumsum(velocity - velocity.mean(axis=0), axis=0) * _STEP_S
    bent = np.full(t.size, math.radians(bent_deg))
    turned = rotate(euler_to_matrix(0.0, 0.0, bent), acceleration)
    wrong = (turned - acceleration) / STANDARD_GRAVITY_MPS2
    wrong = np.stack([np.convolve(w, np.full(100, 0.01), mode="same") for w in wrong.T], axis=1)
    leaned = rotvec_to_matrix(np.cross(wrong, [0.0, 0.0, 1.0])) @ rotation
    told = np.stack(matrix_to_euler(euler_to_matrix(0.0, 0.0, bent) @ leaned), axis=1)
    track = replace(
        recorded(t, rotation, acceleration, path=path),
        attitude_rad=Series.of(t, told),
        gps_velocity_mps=Series.of(t[::5], velocity[::5]),
    )
    assert tilt_rms_deg(track, rotation) < 0.4


def test_slow_sway_is_no_rest_that_tells_a_bias() -> None:
    t = times(60.0)
    # Slower than a degree per second, and by no means standing: the mean of a part is not the bias.
    roll = math.radians(1.5) * np.sin(0.6 * t)
    rotation = euler_to_matrix(roll, 0.0, 0.0 * t)
    track = recorded(t, rotation, np.zeros((t.size, 3)))
    assert track.gyro_radps is not None and track.acc_mps2 is not None
    found = bias_at_rest(t, track.gyro_radps.values, track.acc_mps2.values)
    assert found.sigma[0] > math.radians(0.1) and found.sigma[1] < math.radians(0.05)
    assert (np.abs(found.mean) < 3.0 * found.sigma).all()


def test_steady_turn_is_no_bias() -> None:
    t = times(60.0)
    rotation, acceleration, _ = circling(t)
    track = recorded(t, rotation, acceleration)
    assert track.gyro_radps is not None and track.acc_mps2 is not None
    found = bias_at_rest(t, track.gyro_radps.values, track.acc_mps2.values)
    assert abs(found.mean[2]) < 0.01


def test_bias_at_rest_is_taken_out() -> None:
    t = times(60.0)
    turning = np.clip(t - 25.0, 0.0, 10.0) * 0.3
    rotation = euler_to_matrix(0.0, 0.0, turning)
    found = reference_attitude(recorded(t, rotation, np.zeros((t.size, 3)), bias=(0.01, -0.02, 0.03)), t)
    off = found.rate_radps[t < 20.0].mean(axis=0)
    np.testing.assert_allclose(off, 0.0, atol=3e-4)
    np.testing.assert_allclose(found.errors["gyro offset"].mean, (0.01, -0.02, 0.03), atol=3e-4)
    assert (found.errors["gyro offset"].sigma < math.radians(0.1)).all()


def test_wandering_bias_of_what_stands_hardly_tilts() -> None:
    t = times(120.0)
    rotation = euler_to_matrix(0.0, 0.0, np.clip(t - 60.0, 0.0, 10.0) * 0.3)
    track = recorded(t, rotation, np.zeros((t.size, 3)))
    assert track.gyro_radps is not None
    warming = np.clip((t - 60.0) / 60.0, 0.0, 1.0)[:, None] * np.array([0.002, 0.002, 0.0])
    warmed = Track(gyro_radps=Series.of(t, track.gyro_radps.values + warming), acc_mps2=track.acc_mps2)
    assert tilt_rms_deg(warmed, rotation) < 0.25


def test_products_are_those_of_one_after_the_other() -> None:
    rotations = rotvec_to_matrix(np.random.default_rng(4).standard_normal((103, 3)))
    expected = np.eye(3)
    for one, found in zip(rotations, products(rotations), strict=True):
        expected = expected @ one
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_coning_does_not_make_the_attitude_drift() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    # The axis of 0.3 rad goes round four times in ten seconds: rotations that do not commute.
    rotation = rotvec_to_matrix(
        0.3 * np.stack([np.cos(0.8 * math.pi * t), np.sin(0.8 * math.pi * t), 0.0 * t], axis=1)
    )
    found = integrated(t, body_rate(t, rotation))
    there = rotation[0] @ found[-1]
    assert np.degrees(np.arccos((np.trace(there.T @ rotation[-1]) - 1.0) / 2.0)) < 0.2


def test_rate_of_a_swing_is_right_to_fourth_order() -> None:
    t = np.arange(400) * 0.05
    angle, rate = 0.5 * np.sin(3.0 * t), 1.5 * np.cos(3.0 * t)
    found = body_rate(t, euler_to_matrix(angle, 0.0, 0.0))[:, 0]
    # The error of five points is h^4 w^4 / 30 of the amplitude.
    assert np.abs(found - rate)[4:-4].max() < 1.1 * 1.5 * (0.15**4) / 30.0


def test_gyro_reference_follows_a_tumbling_vehicle_without_its_compass() -> None:
    recipe = Recipe("rich", duration_s=60.0, seed=9)
    track = make_track(recipe)
    without = Track(
        compasses=track.compasses, acc_mps2=track.acc_mps2, gyro_radps=track.gyro_radps, place=track.place
    )
    t = track.compasses[1].time_s
    reference = reference_attitude(without, t)
    assert reference.kind == "fused" and reference.yaw_sigma_rad > 0.5
    truth = stimulus_of(recipe).rotation
    # Down in body axes is known; yaw but for a constant.
    tilt = np.degrees(np.arccos(np.clip(np.sum(reference.rotation[:, 2] * truth[:, 2], axis=1), -1, 1)))
    assert np.sqrt(np.mean(tilt**2)) < 0.5
    yaw = np.unwrap(np.arctan2(reference.rotation[:, 1, 0], reference.rotation[:, 0, 0]))
    true_yaw = np.unwrap(np.arctan2(truth[:, 1, 0], truth[:, 0, 0]))
    off = yaw - true_yaw
    assert np.degrees(np.std(off - np.polyval(np.polyfit(t, off, 1), t))) < 1.0


def test_places_on_both_sides_of_the_date_line_are_neighbours() -> None:
    places = np.array([[-17.0, 179.9999, 0.0], [-17.0, -179.9999, 0.0], [-17.0, 179.9998, 0.0]])
    local = local_position(Series.of(np.arange(3.0), places))
    assert local is not None
    apart_m = 0.0003 * 111_195.0 * math.cos(math.radians(17.0))
    assert np.ptp(local.values[:, 1]) == pytest.approx(apart_m, rel=0.01)


def test_an_accelerometer_without_a_number_is_none() -> None:
    track = make_track(Recipe("rich", seed=9))
    assert track.acc_mps2 is not None and track.reference_q is not None
    gone = Series.of(track.acc_mps2.time_s, np.full_like(track.acc_mps2.values, np.nan))
    roll, pitch, yaw = matrix_to_euler(stimulus_of(Recipe("rich", seed=9)).rotation)
    flown = replace(
        track,
        acc_mps2=gone,
        reference_q=None,
        attitude_rad=Series.of(track.reference_q.time_s, np.stack([roll, pitch, yaw], axis=1)),
    )
    assert reference_attitude(flown, track.reference_q.time_s).kind == "attitude"
