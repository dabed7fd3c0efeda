"""What else knows the attitude: two antennas, the autopilot; and what is said where it is not recorded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back, wrap_pi
from mavcompass.gap.attitude.reference import Choice, body_rate, reference_attitude
from mavcompass.gap.attitude.sensors import receiver_velocity
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

TIME = np.arange(0.0, 40.0, 0.04)
YAW = 2.5 + 1.2 * np.sin(0.4 * TIME) + 0.05 * TIME
ROTATION = euler_to_matrix(0.05 * np.sin(0.9 * TIME), 0.04 * np.cos(0.7 * TIME), YAW)
GYRO_BIAS = np.array([0.0, 0.0, 0.001])


def flight() -> Track:
    """A rover that turns to and fro: noisy gyro, of a bias, and accelerometer."""
    rng = np.random.default_rng(3)
    force = rotate_back(ROTATION, np.array([0.0, 0.0, -STANDARD_GRAVITY_MPS2]))
    gyro = body_rate(TIME, ROTATION) + GYRO_BIAS + 0.002 * rng.standard_normal((TIME.size, 3))
    acc = force + 0.1 * rng.standard_normal((TIME.size, 3))
    return Track(gyro_radps=Series.of(TIME, gyro), acc_mps2=Series.of(TIME, acc))


def antennas(lost: slice | None = None) -> Series:
    """Five times a second, a degree of noise, and silent meanwhile."""
    heard = TIME[::5]
    yaw = wrap_pi(YAW[::5] + 0.017 * np.random.default_rng(4).standard_normal(heard.size))
    if lost is not None:
        yaw[lost] = math.nan
    return Series.of(heard, yaw)


def yaw_off_deg(rotation: FloatArray) -> FloatArray:
    found = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    true = np.arctan2(ROTATION[:, 1, 0], ROTATION[:, 0, 0])
    return np.degrees(wrap_pi(found - true))


@pytest.mark.parametrize("choice", ["auto", "gps-yaw"])
@pytest.mark.parametrize("lost", [None, slice(60, 90)])
def test_two_antennas_fix_the_yaw_and_all_of_it(choice: Choice, lost: slice | None) -> None:
    found = reference_attitude(replace(flight(), gps_yaw_rad=antennas(lost)), TIME, choice)
    assert found.kind == ("fused" if choice == "auto" else "gps-yaw")
    assert float(np.abs(yaw_off_deg(found.rotation)).max()) < 1.0 < math.degrees(found.yaw_sigma_rad)
    assert not found.yaw_unknown and "the two-antenna receiver" in found.notes[0]


def test_the_gyro_alone_leaves_the_yaw_open_though_antennas_were_there() -> None:
    found = reference_attitude(replace(flight(), gps_yaw_rad=antennas()), TIME, "gyro")
    assert found.kind == "gyro" and found.yaw_unknown
    assert "solved with the field" in found.notes[0]


@pytest.mark.parametrize("with_gyro", [True, False])
def test_the_autopilots_attitude_is_taken_as_told_where_it_is_asked_for(with_gyro: bool) -> None:
    roll, pitch = 0.05 * np.sin(0.9 * TIME), 0.04 * np.cos(0.7 * TIME)
    told = Series.of(TIME, np.stack([roll, pitch, wrap_pi(YAW)], axis=1))
    track = flight() if with_gyro else Track()
    found = reference_attitude(replace(track, attitude_rad=told), TIME, "attitude")
    assert found.kind == "attitude" and "autopilot's own" in found.notes[0]
    assert float(np.abs(yaw_off_deg(found.rotation)).max()) < 0.05
    off = (found.rate_radps - body_rate(TIME, ROTATION))[5:-5].mean(axis=0)
    assert off[2] == pytest.approx(GYRO_BIAS[2] if with_gyro else 0.0, abs=5e-4)
    # A compass bends the yaw that it steers by the sine and cosine of the heading, and it drifts.
    assert found.curves_rad.shape == (TIME.size, 3, 3)
    assert float(np.hypot(*found.curves_rad[:, 2, :2].T).max()) == pytest.approx(math.radians(5.0))


@pytest.mark.parametrize("choice", ["columns", "attitude", "gps-yaw"])
@pytest.mark.parametrize("few", [True, False])
def test_a_reference_that_is_not_recorded_is_named(choice: Choice, few: bool) -> None:
    track = flight()
    if few:
        five = TIME[:5]
        track = replace(
            track,
            gps_yaw_rad=Series.of(five, np.full(5, math.nan)),
            attitude_rad=Series.of(five, np.zeros((5, 3))),
            reference_q=Series.of(five, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))),
        )
    with pytest.raises(BadRecording, match=f"nothing for the attitude reference '{choice}'"):
        reference_attitude(track, TIME, choice)


@pytest.mark.parametrize("count", [1, 4, 5])
def test_a_rate_needs_five_points(count: int) -> None:
    rate = body_rate(TIME[:count], ROTATION[:count])
    assert rate.shape == (count, 3) and bool(rate.any()) is (count == 5)


@pytest.mark.parametrize(("every_s", "told"), [(0.2, 1.0), (1.0, 3.0)])
def test_the_receivers_own_velocity_comes_before_what_a_bent_filter_makes_of_it(
    every_s: float, told: float
) -> None:
    t = np.arange(0.0, 80.0, 0.1)
    own = np.arange(0.0, 80.0, every_s)
    track = Track(
        compasses={},
        gps_velocity_mps=Series.of(t, np.tile([3.0, 0.0, -0.5], (t.size, 1))),
        receiver_velocity_mps=Series.of(own, np.tile([1.0, 0.0, math.nan], (own.size, 1))),
    )
    seen = receiver_velocity(track, t)
    assert seen is not None
    np.testing.assert_allclose(seen.mean_mps, np.tile([told, 0.0, -0.5], (len(seen.time_s), 1)))
