"""The tilt of a hovering copter: its accelerometer shows the thrust, its estimator may be bent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation.sway import sway
from mavcompass.calibration.observation.tilt import tilt_during
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

RATE_HZ, LENGTH_S = 50.0, 24.0
TIME = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
START_S, END_S = 11.0, 12.7
PERIOD_S, SWAY_MPS = 4.2, 0.45
BIAS_RADPS = np.radians([0.1, -0.08, 0.05])


def hovering(
    velocity: bool = True, bent_deg: float = 0.0, shaking_mps2: float = 0.0, sway_mps: float = SWAY_MPS
) -> tuple[Track, FloatArray]:
    """Make a copter that sways in a circle while it turns; also its true roll and pitch, (N, 2).

    v = V (cos wt, sin wt) asks for a = V w (-sin wt, cos wt), and the lean atan(a / g) that gives it.
    """
    rng = np.random.default_rng(8)
    omega = 2.0 * math.pi / PERIOD_S
    yaw = 2.0 + 0.5 * math.pi * np.clip((TIME - 6.0) / 2.0, 0.0, 1.0)
    yaw += 0.5 * math.pi * np.clip((TIME - 15.0) / 2.0, 0.0, 1.0)
    along = np.stack([np.cos(omega * TIME), np.sin(omega * TIME)], axis=1)
    acceleration = sway_mps * omega * np.stack([-along[:, 1], along[:, 0]], axis=1)
    force_ned = np.column_stack([acceleration, np.full(TIME.size, -STANDARD_GRAVITY_MPS2)])
    down = -force_ned / np.linalg.norm(force_ned, axis=1, keepdims=True)  # the body's, in NED
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, right = down[:, 0] * c + down[:, 1] * s, -down[:, 0] * s + down[:, 1] * c
    pitch = np.arctan2(ahead, down[:, 2])
    roll = np.arcsin(-right)
    rotation = np.array([rotation_matrix(*angles) for angles in zip(roll, pitch, yaw, strict=True)]).reshape(
        -1, 3, 3
    )
    turn = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    between = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) * RATE_HZ
    rate = np.concatenate([between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]]) + BIAS_RADPS
    force = np.einsum("nji,nj->ni", rotation, force_ned) + shaking_mps2 * rng.standard_normal((TIME.size, 3))
    estimate = np.stack([roll + math.radians(bent_deg), pitch, yaw + 1.0], axis=1)
    heard = np.arange(0.2, LENGTH_S, 0.2)
    speed = sway_mps * np.column_stack([np.cos(omega * (heard - 0.11)), np.sin(omega * (heard - 0.11))])
    track = Track(
        autopilot="ardupilot",
        vehicle="copter",
        acc_mps2=Series.of(TIME, force),
        gyro_radps=Series.of(TIME, rate),
        attitude_rad=Series.of(TIME[::5], estimate[::5]),
        gps_velocity_mps=Series.of(heard, np.column_stack([speed, np.full(heard.size, np.nan)]))
        if velocity
        else None,
    )
    return track, np.stack([roll, pitch], axis=1)


def truth_deg(tilt: FloatArray) -> FloatArray:
    inside = (TIME >= START_S) & (TIME <= END_S)
    return np.degrees(tilt[inside].mean(axis=0))


def dwell_tilt_deg(track: Track) -> tuple[FloatArray, float]:
    roll, pitch, sigma, _ = tilt_during(track, TIME[(TIME >= START_S) & (TIME <= END_S)])
    return np.degrees([roll, pitch]), math.degrees(sigma)


def test_the_accelerometer_of_a_hover_reads_level_whatever_the_tilt() -> None:
    track, tilt = hovering()
    assert track.acc_mps2 is not None
    shown = track.acc_mps2.between(START_S, END_S).values.mean(axis=0)
    assert np.linalg.norm(shown[:2]) < 0.01
    assert np.linalg.norm(truth_deg(tilt)) > 1.5


@pytest.mark.parametrize("velocity", [True, False], ids=["receiver", "none"])
def test_newton_tells_the_tilt_within_its_sigma(velocity: bool) -> None:
    track, tilt = hovering(velocity, bent_deg=0.7)
    found = sway(track, START_S, END_S)
    assert found is not None
    x, y, z = found.down
    error = np.degrees([math.atan2(y, z), -math.asin(x)]) - truth_deg(tilt)
    assert np.abs(error).max() < (0.1 if velocity else 0.3)
    assert np.abs(error).max() < 3.0 * math.degrees(found.sigma_rad)
    # The accelerometer is not believed: it changes by far more than gravity would.
    assert math.degrees(found.swing_rad) > 1.5


@pytest.mark.parametrize("bent_deg", [0.0, 0.7, -2.0])
def test_a_bent_estimator_does_not_bend_the_tilt_of_a_dwell(bent_deg: float) -> None:
    track, tilt = hovering(bent_deg=bent_deg, shaking_mps2=0.05)
    found, sigma_deg = dwell_tilt_deg(track)
    assert np.abs(found - truth_deg(tilt)).max() < 0.15
    assert sigma_deg < 0.15


def test_motors_that_shake_make_the_tilt_less_certain() -> None:
    calm, _ = hovering(shaking_mps2=0.02)
    shaken, tilt = hovering(shaking_mps2=1.0)
    found, sigma_deg = dwell_tilt_deg(shaken)
    assert sigma_deg > dwell_tilt_deg(calm)[1]
    assert np.abs(found - truth_deg(tilt)).max() < 3.0 * sigma_deg


def test_a_wild_swing_is_no_small_angle_and_says_so() -> None:
    track, tilt = hovering(sway_mps=4.0)
    assert np.degrees(np.abs(tilt).max()) > 25.0
    found, sigma_deg = dwell_tilt_deg(track)
    assert sigma_deg > 1.0
    assert np.abs(found - truth_deg(tilt)).max() < 3.0 * sigma_deg


def test_a_copter_that_stands_is_as_level_as_its_accelerometer_says() -> None:
    lean = math.radians(2.0)
    force = np.tile([0.0, -math.sin(lean), -math.cos(lean)], (TIME.size, 1)) * STANDARD_GRAVITY_MPS2
    track = Track(
        autopilot="ardupilot",
        vehicle="copter",
        acc_mps2=Series.of(TIME, force),
        gyro_radps=Series.of(TIME, np.tile(BIAS_RADPS, (TIME.size, 1))),
    )
    found, sigma_deg = dwell_tilt_deg(track)
    assert found == pytest.approx([2.0, 0.0], abs=0.05)
    assert sigma_deg < 0.15


def test_without_a_gyro_nothing_is_told() -> None:
    assert sway(Track(vehicle="copter"), 0.0, 1.0) is None


def test_a_gap_in_the_recording_is_not_bridged() -> None:
    track, _ = hovering()
    assert track.gyro_radps is not None
    kept = np.abs(TIME - 11.8) > 0.5
    with_gap = Track(
        vehicle="copter",
        acc_mps2=track.acc_mps2,
        gyro_radps=Series.of(TIME[kept], np.asarray(track.gyro_radps.values)[kept]),
    )
    assert sway(with_gap, START_S, END_S) is None
