"""Biases of gyro and accelerometer that show against the attitude and the receiver."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude.reference import body_rate, reference_attitude
from mavcompass.gap.attitude.scatter import Bias
from mavcompass.gap.attitude.steering import (
    accelerometer_fault,
    sensor_fault,
    without_fault,
)
from mavcompass.gap.result import Cause
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


USUAL_GYRO, USUAL_ACC = (0.01, -0.005, 0.008), (0.1, 0.05, -0.1)


def smoothed_bias(track: Track) -> Bias | None:
    assert track.gyro_radps is not None
    return reference_attitude(track, track.gyro_radps.time_s).gyro_bias


@pytest.fixture(scope="module")
def baseline() -> Track:
    # What it always had is no fault.
    return made(100, USUAL_GYRO, USUAL_ACC)


@pytest.fixture(scope="module")
def bias_before(baseline: Track) -> Bias | None:
    return smoothed_bias(baseline)


def beside(values: tuple[float, ...], axis: int, more: float) -> tuple[float, ...]:
    return tuple(v + more * (i == axis) for i, v in enumerate(values))


def assert_is(cause: Cause, effect: str, axis: int, size: float) -> None:
    """Assert the effect, its value on one axis, nothing beside it, and intervals that hold the truth."""
    assert cause.effect == effect
    for i, name in enumerate("xyz"):
        true = size if i == axis else 0.0
        assert cause.parameters[name] == pytest.approx(true, abs=0.1 * abs(size))
        low, high = cause.ci95[name]
        assert low < cause.parameters[name] < high
        # Twice the interval: every axis of every case must pass.
        assert abs(cause.parameters[name] - true) < high - low


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bias_of_the_gyro_is_found_on_each_axis(bias_before: Bias | None, axis: int) -> None:
    track = made(2, beside(USUAL_GYRO, axis, -GYRO), USUAL_ACC)
    (cause,) = sensor_fault("gyro offset", smoothed_bias(track), bias_before)
    assert_is(cause, "gyro_bias", axis, -GYRO)


def smoothed_scale(track: Track) -> Bias | None:
    assert track.gyro_radps is not None
    return reference_attitude(track, track.gyro_radps.time_s).gyro_scale


@pytest.mark.parametrize(("axis", "size"), [(0, 0.08), (1, -0.1), (2, 0.09), (2, -0.06)])
def test_scale_of_the_gyro_is_found_where_it_turns(baseline: Track, axis: int, size: float) -> None:
    track = made(2, USUAL_GYRO, USUAL_ACC)
    assert track.gyro_radps is not None
    stretched = track.gyro_radps.values * (1.0 + size * np.eye(3)[axis])
    faulty = replace(track, gyro_radps=Series.of(track.gyro_radps.time_s, stretched))
    (cause,) = sensor_fault("gyro gain", smoothed_scale(faulty), smoothed_scale(baseline))
    assert cause.effect == "gyro_scale"
    for i, name in enumerate("xyz"):
        (low, high), true = cause.ci95[name], size * (i == axis)
        assert abs(cause.parameters[name] - true) < high - low
    low, high = cause.ci95["xyz"[axis]]
    assert high - low < abs(size)


@pytest.mark.parametrize("seed", range(4))
def test_scale_that_any_gyro_may_have_is_no_fault(baseline: Track, seed: int) -> None:
    track = made(20 + seed, USUAL_GYRO, USUAL_ACC)
    assert track.gyro_radps is not None
    usual = track.gyro_radps.values * [1.01, 0.992, 0.988]
    track = replace(track, gyro_radps=Series.of(track.gyro_radps.time_s, usual))
    assert sensor_fault("gyro gain", smoothed_scale(track), smoothed_scale(baseline)) == ()


@pytest.mark.parametrize("seed", [3, 4])
def test_ten_attitudes_a_second_are_enough(seed: int) -> None:
    """Such a bias was silent in telemetry of ten messages a second, as many ground stations ask for it."""

    def ten(track: Track) -> Track:
        assert track.attitude_rad is not None
        told = track.attitude_rad
        at = np.arange(told.time_s[0], told.time_s[-1], 0.1)
        nearest = np.searchsorted(told.time_s, at)
        return replace(track, attitude_rad=Series.of(told.time_s[nearest], told.values[nearest]))

    good = ten(made(100, USUAL_GYRO, USUAL_ACC))
    (cause,) = accelerometer_fault(ten(made(seed, USUAL_GYRO, beside(USUAL_ACC, 0, ACC))), good)
    assert_is(cause, "accel_bias", 0, ACC)
    assert accelerometer_fault(ten(made(seed, USUAL_GYRO, USUAL_ACC)), good) == ()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bias_of_the_accelerometer_is_found_on_each_axis(baseline: Track, axis: int) -> None:
    (cause,) = accelerometer_fault(made(3, USUAL_GYRO, beside(USUAL_ACC, axis, -ACC)), baseline)
    assert_is(cause, "accel_bias", axis, -ACC)


def test_biases_of_both_sensors_are_found_beside_each_other(
    baseline: Track, bias_before: Bias | None
) -> None:
    track = made(1, beside(USUAL_GYRO, 2, GYRO), beside(USUAL_ACC, 0, ACC))
    fault = accelerometer_fault(track, baseline)
    assert_is(fault[0], "accel_bias", 0, ACC)
    (cause,) = sensor_fault("gyro offset", smoothed_bias(without_fault(track, fault)), bias_before)
    assert_is(cause, "gyro_bias", 2, GYRO)


@pytest.mark.parametrize("seed", range(4))
def test_healthy_pair_has_no_fault(baseline: Track, bias_before: Bias | None, seed: int) -> None:
    track = made(10 + seed, USUAL_GYRO, USUAL_ACC)
    assert sensor_fault("gyro offset", smoothed_bias(track), bias_before) == ()
    assert accelerometer_fault(track, baseline) == ()


def test_what_cannot_be_compared_is_not_judged(baseline: Track) -> None:
    track = made(1, (GYRO, 0.0, 0.0), (ACC, 0.0, 0.0))
    assert accelerometer_fault(track, baseline) != ()
    assert accelerometer_fault(replace(track, attitude_rad=None), baseline) == ()
    assert accelerometer_fault(track, replace(baseline, attitude_rad=None)) == ()
    assert accelerometer_fault(replace(track, gps_velocity_mps=None), baseline) == ()
    slow = track.attitude_rad
    assert slow is not None
    sparse = replace(track, attitude_rad=Series.of(slow.time_s[::4], slow.values[::4]))
    assert accelerometer_fault(sparse, baseline) == ()
    known = Bias(np.full(3, GYRO), np.full(3, 1e-4))
    assert sensor_fault("gyro offset", known, Bias(np.zeros(3), known.sigma)) != ()
    assert sensor_fault("gyro offset", known, None) == () and sensor_fault("gyro offset", None, known) == ()


def bent_by_its_turns(track: Track, times: float) -> Track:
    """Bend the compass that steers the filter, as motors do that turn a vehicle left and right."""
    attitude = track.attitude_rad
    assert attitude is not None and track.acc_mps2 is not None
    sideways = track.acc_mps2.values[:, 1] / STANDARD_GRAVITY_MPS2 + np.sin(attitude.values[:, 0])
    yaw = attitude.values[:, 2] + times * np.convolve(sideways, np.full(25, 0.04), mode="same")
    return replace(track, attitude_rad=Series.of(attitude.time_s, np.c_[attitude.values[:, :2], yaw]))


def test_acceleration_that_a_bent_yaw_turns_is_no_fault(baseline: Track) -> None:
    bent = [
        bent_by_its_turns(made(seed, USUAL_GYRO, USUAL_ACC), s) for seed in range(20, 24) for s in (-6.0, 6.0)
    ]
    for track in bent:
        assert accelerometer_fault(track, baseline) == ()
    # Nothing but the gyro tells the one from the other.
    without = [accelerometer_fault(replace(track, gyro_radps=None), baseline) for track in bent]
    assert sum(fault != () for fault in without) >= 4


def test_change_within_its_own_doubt_is_no_fault() -> None:
    before = Bias(np.zeros(3), np.full(3, 1e-4))
    moved = np.array([2.0 * GYRO, 0.0, 0.0])
    assert sensor_fault("gyro offset", Bias(moved, np.full(3, GYRO)), before) == ()
    assert sensor_fault("gyro offset", Bias(moved, np.full(3, 0.1 * GYRO)), before) != ()


@pytest.mark.parametrize(
    ("sigmas", "is_fault"),
    [((4.7, 4.4, 0.0), True), ((4.6, 4.4, 0.0), False), ((6.3, 0.0, 0.0), False), ((6.5, 0.0, 0.0), True)],
)
def test_three_axes_are_judged_together(sigmas: tuple[float, ...], is_fault: bool) -> None:
    """Two that are off by less than six sigmas each are as improbable as one that is off by more."""
    before = Bias(np.zeros(3), np.zeros(3))
    now = Bias(GYRO * np.array(sigmas), np.full(3, GYRO))
    assert (sensor_fault("gyro offset", now, before) != ()) is is_fault


def test_fault_is_taken_out_with_the_witness_that_was_fed_with_it(baseline: Track) -> None:
    track = made(1, USUAL_GYRO, beside(USUAL_ACC, 0, ACC))
    clean = without_fault(track, accelerometer_fault(track, baseline))
    healthy = made(1, USUAL_GYRO, USUAL_ACC)
    assert clean.attitude_rad is None and clean.acc_mps2 is not None and healthy.acc_mps2 is not None
    np.testing.assert_allclose(clean.acc_mps2.values, healthy.acc_mps2.values, atol=0.1 * ACC)
    assert without_fault(track, ()) is track
