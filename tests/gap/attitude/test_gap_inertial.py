"""Errors of gyro and accelerometer that the smoothed attitude solves for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude.reference import body_rate, reference_attitude
from mavcompass.gap.attitude.sensors import Bias, sensor_faults
from mavcompass.gap.result import Cause
from mavcompass.simulation.effects.effect import Detector
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


def errors(track: Track) -> Mapping[Detector, Bias]:
    assert track.gyro_radps is not None
    return reference_attitude(track, track.gyro_radps.time_s).errors


@pytest.fixture(scope="module")
def usual() -> Mapping[Detector, Bias]:
    # What it always had is no fault.
    return errors(made(100, USUAL_GYRO, USUAL_ACC))


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
def test_bias_of_the_gyro_is_found_on_each_axis(usual: Mapping[Detector, Bias], axis: int) -> None:
    (cause,) = sensor_faults(errors(made(2, beside(USUAL_GYRO, axis, -GYRO), USUAL_ACC)), usual)
    assert_is(cause, "gyro_bias", axis, -GYRO)


@pytest.mark.parametrize(("axis", "size"), [(0, 0.08), (1, -0.1), (2, 0.09), (2, -0.06)])
def test_scale_of_the_gyro_is_found_where_it_turns(
    usual: Mapping[Detector, Bias], axis: int, size: float
) -> None:
    track = made(2, USUAL_GYRO, USUAL_ACC)
    assert track.gyro_radps is not None
    stretched = track.gyro_radps.values * (1.0 + size * np.eye(3)[axis])
    faulty = replace(track, gyro_radps=Series.of(track.gyro_radps.time_s, stretched))
    (cause,) = sensor_faults(errors(faulty), usual)
    assert cause.effect == "gyro_scale"
    for i, name in enumerate("xyz"):
        (low, high), true = cause.ci95[name], size * (i == axis)
        assert abs(cause.parameters[name] - true) < high - low
    low, high = cause.ci95["xyz"[axis]]
    assert high - low < abs(size)


@pytest.mark.parametrize("every", [1, 3, 12])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bias_of_the_accelerometer_is_found_on_each_axis(
    usual: Mapping[Detector, Bias], axis: int, every: int
) -> None:
    """However often the autopilot's attitude is told: what is felt and the receiver tell it."""
    track = made(3, USUAL_GYRO, beside(USUAL_ACC, axis, -ACC))
    told = track.attitude_rad
    assert told is not None
    sparse = replace(track, attitude_rad=Series.of(told.time_s[::every], told.values[::every]))
    (cause,) = sensor_faults(errors(sparse), usual)
    assert_is(cause, "accel_bias", axis, -ACC)


def test_biases_of_both_sensors_are_found_beside_each_other(usual: Mapping[Detector, Bias]) -> None:
    track = made(1, beside(USUAL_GYRO, 2, GYRO), beside(USUAL_ACC, 0, ACC))
    of_acc, of_gyro = sensor_faults(errors(track), usual)
    assert_is(of_acc, "accel_bias", 0, ACC)
    assert_is(of_gyro, "gyro_bias", 2, GYRO)


@pytest.mark.parametrize("seed", range(4))
def test_healthy_pair_has_no_fault(usual: Mapping[Detector, Bias], seed: int) -> None:
    assert sensor_faults(errors(made(10 + seed, USUAL_GYRO, USUAL_ACC)), usual) == ()


def test_what_cannot_be_compared_is_not_judged(usual: Mapping[Detector, Bias]) -> None:
    found = errors(made(1, (GYRO, 0.0, 0.0), (ACC, 0.0, 0.0)))
    assert {cause.effect for cause in sensor_faults(found, usual)} == {"accel_bias", "gyro_bias"}
    assert sensor_faults(found, {}) == sensor_faults({}, usual) == ()


def bent_by_its_turns(track: Track, times: float) -> Track:
    """Bend the compass that steers the filter, as motors do that turn a vehicle left and right."""
    attitude = track.attitude_rad
    assert attitude is not None and track.acc_mps2 is not None
    sideways = track.acc_mps2.values[:, 1] / STANDARD_GRAVITY_MPS2 + np.sin(attitude.values[:, 0])
    yaw = attitude.values[:, 2] + times * np.convolve(sideways, np.full(25, 0.04), mode="same")
    return replace(track, attitude_rad=Series.of(attitude.time_s, np.c_[attitude.values[:, :2], yaw]))


def test_acceleration_that_a_bent_yaw_turns_is_no_fault(usual: Mapping[Detector, Bias]) -> None:
    for seed in range(20, 24):
        for times in (-6.0, 6.0):
            track = bent_by_its_turns(made(seed, USUAL_GYRO, USUAL_ACC), times)
            assert sensor_faults(errors(track), usual) == ()


def test_change_within_its_own_doubt_is_no_fault() -> None:
    moved = np.array([2.0 * GYRO, 0.0, 0.0])
    assert judged(moved, np.zeros(3), GYRO) == ()
    assert judged(moved, np.zeros(3), 0.1 * GYRO) != ()


def judged(now: FloatArray, before: FloatArray, sigma: float) -> tuple[Cause, ...]:
    both = (Bias(now, np.full(3, sigma)), Bias(before, np.zeros(3)))
    return sensor_faults({"gyro offset": both[0]}, {"gyro offset": both[1]})


@pytest.mark.parametrize(
    ("sigmas", "is_fault"),
    [((4.7, 4.4, 0.0), True), ((4.6, 4.4, 0.0), False), ((6.3, 0.0, 0.0), False), ((6.5, 0.0, 0.0), True)],
)
def test_three_axes_are_judged_together(sigmas: tuple[float, ...], is_fault: bool) -> None:
    """Two that are off by less than six sigmas each are as improbable as one that is off by more."""
    assert (judged(GYRO * np.array(sigmas), np.zeros(3), GYRO) != ()) is is_fault
