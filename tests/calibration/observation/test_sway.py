"""The tilt of a hovering copter: its accelerometer shows the thrust, its estimator may be bent."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.calibration.observation.sway import sway
from mavcompass.calibration.observation.tilt import tilt_during
from mavcompass.calibration.observation.upright import upright
from mavcompass.frames import FloatArray
from mavcompass.heading.gravity import down_in_body
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


def test_a_dwell_that_has_just_ended_is_told_by_more_of_what_was_before() -> None:
    """Live, nothing is recorded after it yet."""
    track, tilt = hovering(bent_deg=0.7, shaking_mps2=0.05)
    start_s, end_s = 20.6, 22.3
    inside = (TIME >= start_s) & (TIME <= end_s)
    more, less = (sway(track.between(since_s, end_s), start_s, end_s) for since_s in (0.0, start_s - 10.0))
    assert more is not None and less is not None
    assert more.sigma_rad < 0.7 * less.sigma_rad
    roll, pitch, sigma, _ = tilt_during(track.between(0.0, end_s), TIME[inside])
    off_deg = np.degrees([roll, pitch] - tilt[inside].mean(axis=0))
    assert np.abs(off_deg).max() < 0.12 and np.abs(off_deg).max() < 2.0 * math.degrees(sigma)


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


def away_deg(track: Track, tilt: FloatArray) -> FloatArray:
    """Return by how much a recording's roll and pitch are off away from its ends, (M, 2)."""
    assert track.attitude_rad is not None
    inside = track.attitude_rad.between(2.0, LENGTH_S - 2.0)
    true = np.stack([np.interp(inside.time_s, TIME, column) for column in tilt.T], axis=1)
    return np.degrees(inside.values[:, :2] - true)


def test_roll_and_pitch_of_a_whole_flight_are_mended_by_newton() -> None:
    track, tilt = hovering(bent_deg=1.5)
    found = upright(track)
    assert found is not None
    assert np.abs(away_deg(track, tilt)).max() > 1.4
    off = away_deg(found.track, tilt)
    sigma = np.degrees(found.sigma_rad.between(2.0, LENGTH_S - 2.0).values)
    assert np.abs(off).max() < 0.2 and float(np.sqrt((off**2).mean())) < float(sigma.max()) < 0.2


def test_where_newton_cannot_tell_the_estimator_is_believed() -> None:
    track, _ = hovering(bent_deg=1.5)
    assert track.gyro_radps is not None and track.gps_velocity_mps is not None
    kept = np.abs(TIME - 6.0) > 0.5
    gyro = Series.of(TIME[kept], track.gyro_radps.values[kept])
    late = track.gps_velocity_mps.between(13.0, LENGTH_S)
    found = upright(replace(track, gyro_radps=gyro, gps_velocity_mps=late))
    assert found is not None and track.attitude_rad is not None
    assert np.isfinite(found.sigma_rad.values).all()
    roll = np.interp(5.0, found.track.attitude_rad.time_s, found.track.attitude_rad.values[:, 0])  # type: ignore[union-attr]
    assert roll == pytest.approx(float(track.attitude_rad.at(5.0)[0]), abs=1e-3)
    assert float(found.sigma_rad.at(0.5)) == pytest.approx(math.radians(0.3))
    # What is seen of it soon after is not forgotten.
    assert float(found.sigma_rad.at(5.0)) > math.radians(0.6)


def test_what_stands_or_has_no_receiver_keeps_its_roll_and_pitch() -> None:
    track, _ = hovering()
    assert upright(replace(track, vehicle="sub")) is None
    assert upright(replace(track, gps_velocity_mps=None)) is None
    assert upright(replace(track, attitude_rad=None)) is None


def test_what_brakes_leans_only_in_its_accelerometer() -> None:
    """Steered wheels on the level: half a turn between straight stretches, braked by 1.2 m/s^2."""
    ahead_mps2 = 1.2 * np.sign(np.sin(2.0 * math.pi * TIME / 6.0)) * (TIME < 18.0)
    yaw_rate = np.where((TIME > 6.0) & (TIME < 12.0), math.radians(30.0), 0.0)
    yaw, speed = np.cumsum(yaw_rate) / RATE_HZ, np.cumsum(ahead_mps2) / RATE_HZ
    force = np.stack([ahead_mps2, speed * yaw_rate, np.full(TIME.size, -STANDARD_GRAVITY_MPS2)], axis=1)
    going = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.full(TIME.size, np.nan)], axis=1)
    track = Track(
        autopilot="ardupilot",
        vehicle="rover",
        acc_mps2=Series.of(TIME, force),
        gyro_radps=Series.of(TIME, np.column_stack([0.0 * TIME, 0.0 * TIME, yaw_rate]) + BIAS_RADPS),
        gps_velocity_mps=Series.of(TIME[::10] + 0.11, going[::10]),
    )
    leaning = np.degrees(np.arccos(down_in_body(track, TIME)[:, 2]))
    assert leaning.max() > 6.0
    found = upright(track)
    assert found is not None and found.track.acc_mps2 is None
    mended = np.degrees(np.arccos(down_in_body(found.track, TIME)[:, 2]))
    assert mended.max() < 0.3
    # What stands is as level as its accelerometer says.
    assert mended[TIME > 20.0].max() < 0.05
    assert np.degrees(found.sigma_rad.at(22.0)) == pytest.approx(0.02, abs=0.005)


def test_rates_that_are_cut_to_nothing_are_not_certain() -> None:
    """Noise below the step of whole numbers shows no noise, and may hide a rate of half a step."""
    track, _ = hovering()
    whole = replace(track, gyro_truncation_radps=0.001)
    certain, less = (sway(each, START_S, END_S) for each in (track, whole))
    assert certain is not None and less is not None
    assert less.sigma_rad > certain.sigma_rad


def test_a_gyro_heard_too_seldom_tells_nothing() -> None:
    track, _ = hovering(bent_deg=1.5)
    assert track.gyro_radps is not None
    assert upright(replace(track, gyro_radps=Series.of(TIME[::10], track.gyro_radps.values[::10]))) is None
    assert upright(replace(track, gyro_radps=None)) is None
