"""Biases of gyro and accelerometer that show against the attitude and the receiver."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude.inertial import inertial_faults, without_faults
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

GYRO, ACC = math.radians(1.5), 0.4
NONE = (0.0, 0.0, 0.0)


def made(seed: int, gyro_bias: tuple[float, ...] = NONE, acc_bias: tuple[float, ...] = NONE) -> Track:
    """Make a flight of eights with some bank and pitch, its attitude and the receiver's velocity."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 120.0, 0.04)
    phase = rng.uniform(0.0, 6.0, 5)
    w = 2.0 * np.pi / rng.uniform(16.0, 24.0)
    roll = math.radians(15.0) * np.sin(w * t + phase[0])
    pitch = math.radians(6.0) * np.sin(1.7 * w * t + phase[1])
    yaw = 3.0 * np.sin(w * t + phase[2]) + 0.02 * t
    rotation = euler_to_matrix(roll, pitch, yaw)
    acceleration = np.stack(
        [1.2 * np.sin(w * t + phase[3]), 0.9 * np.cos(2.0 * w * t + phase[4]), 0.0 * t], axis=1
    )
    velocity = np.stack(
        [-1.2 / w * np.cos(w * t + phase[3]), 0.45 / w * np.sin(2.0 * w * t + phase[4]), 0.0 * t], axis=1
    )

    def noisy(values: FloatArray, sigma: float) -> FloatArray:
        return values + rng.normal(0.0, sigma, values.shape)

    force = rotate_back(rotation, acceleration - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    angles = np.stack([roll, pitch, (yaw + np.pi) % (2.0 * np.pi) - np.pi], axis=1)
    return Track(
        compasses={1: MagSeries(1, Series.of(t, np.tile([200.0, 0.0, 400.0], (t.size, 1))))},
        gyro_radps=Series.of(t, noisy(body_rate(t, rotation), 0.003) + gyro_bias),
        acc_mps2=Series.of(t, noisy(force, 0.05) + acc_bias),
        attitude_rad=Series.of(t, noisy(angles, math.radians(0.02))),
        gps_velocity_mps=Series.of(t[::5], noisy(velocity, 0.05)[::5]),
    )


@pytest.fixture(scope="module")
def baseline() -> Track:
    # What it always had is no fault.
    return made(100, (0.01, -0.005, 0.008), (0.1, 0.05, -0.1))


def test_biases_that_came_are_found_with_their_values(baseline: Track) -> None:
    track = made(1, (0.01, -0.005, 0.008 + GYRO), (0.1 + ACC, 0.05, -0.1))
    found = {cause.effect: cause for cause in inertial_faults(track, baseline)}
    assert set(found) == {"gyro_bias", "accel_bias"}
    for effect, true in (("gyro_bias", [0.0, 0.0, GYRO]), ("accel_bias", [ACC, 0.0, 0.0])):
        size = max(true)
        for axis, value in zip("xyz", true, strict=True):
            assert found[effect].parameters[axis] == pytest.approx(value, abs=0.1 * size)
            low, high = found[effect].ci95[axis]
            assert low <= found[effect].parameters[axis] <= high


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_axis_of_each_sensor_is_found_alone(baseline: Track, axis: int) -> None:
    one = np.zeros(3)
    one[axis] = -1.0
    gyro = tuple((np.array([0.01, -0.005, 0.008]) + GYRO * one).tolist())
    (cause,) = inertial_faults(made(2, gyro, (0.1, 0.05, -0.1)), baseline)
    assert cause.effect == "gyro_bias"
    assert cause.parameters["xyz"[axis]] == pytest.approx(-GYRO, rel=0.1)
    acc = tuple((np.array([0.1, 0.05, -0.1]) + ACC * one).tolist())
    (cause,) = inertial_faults(made(3, (0.01, -0.005, 0.008), acc), baseline)
    assert cause.effect == "accel_bias"
    assert cause.parameters["xyz"[axis]] == pytest.approx(-ACC, rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_healthy_pair_has_no_fault(baseline: Track, seed: int) -> None:
    assert inertial_faults(made(10 + seed, (0.01, -0.005, 0.008), (0.1, 0.05, -0.1)), baseline) == ()


def test_what_cannot_be_compared_is_not_judged(baseline: Track) -> None:
    track = made(1, (GYRO, 0.0, 0.0), (ACC, 0.0, 0.0))
    assert inertial_faults(replace(track, attitude_rad=None), baseline) == ()
    assert inertial_faults(track, replace(baseline, attitude_rad=None)) == ()
    alone = inertial_faults(replace(track, gps_velocity_mps=None), baseline)
    assert [cause.effect for cause in alone] == ["gyro_bias"]
    slow = track.attitude_rad
    assert slow is not None
    sparse = replace(track, attitude_rad=Series.of(slow.time_s[::3], slow.values[::3]))
    assert inertial_faults(sparse, baseline) == ()


def test_faults_are_taken_out_with_the_witness_that_was_fed_with_them(baseline: Track) -> None:
    track = made(1, (0.01, -0.005, 0.008 + GYRO), (0.1 + ACC, 0.05, -0.1))
    clean = without_faults(track, inertial_faults(track, baseline))
    healthy = made(1, (0.01, -0.005, 0.008), (0.1, 0.05, -0.1))
    assert clean.attitude_rad is None and clean.gyro_radps is not None and clean.acc_mps2 is not None
    assert healthy.gyro_radps is not None and healthy.acc_mps2 is not None
    np.testing.assert_allclose(clean.gyro_radps.values, healthy.gyro_radps.values, atol=0.1 * GYRO)
    np.testing.assert_allclose(clean.acc_mps2.values, healthy.acc_mps2.values, atol=0.1 * ACC)
    assert without_faults(track, ()) is track
