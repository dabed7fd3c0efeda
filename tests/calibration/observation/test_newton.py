"""The parts of the tilt by Newton's law (T1): each against what it should be."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation.sway import (
    _carried,
    _on_the_circle,
    _rotations,
    _samples,
    _solve,
    _swing,
    _tilt_errors,
    _Velocity,
    _velocity,
    _walks,
    integral,
    level_by_newton,
    sway,
    white_noise,
)
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
DEG = math.radians(1.0)
TIME = np.arange(1201.0) * 0.02  # 24 s
START_S, END_S = 11.0, 13.0


def recording(
    force: FloatArray | None = None, rate: FloatArray | None = None, vehicle: str = "copter", **more: Any
) -> Track:
    still = np.zeros((TIME.size, 3))
    up = np.tile([0.0, 0.0, -G], (TIME.size, 1))
    return Track(
        vehicle=vehicle,
        acc_mps2=Series.of(TIME, up if force is None else force),
        gyro_radps=Series.of(TIME, still if rate is None else rate),
        **more,
    )


def moving(velocity: tuple[float, float] = (0.0, 0.0), every_s: float = 0.2) -> Series:
    heard = np.arange(0.0, 24.0, every_s)
    return Series.of(heard, np.tile([*velocity, 0.0], (heard.size, 1)))


def test_small_turns_are_matrices_to_the_third_order() -> None:
    vector = np.array([[0.1, -0.2, 0.15], [0.0, 0.0, 0.3], [0.0, 0.0, 0.0]])
    found = _rotations(vector)
    assert found @ np.swapaxes(found, 1, 2) == pytest.approx(np.tile(np.eye(3), (3, 1, 1)), abs=1e-4)
    c, s = math.cos(0.3), math.sin(0.3)
    assert found[1] == pytest.approx(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), abs=1e-4)
    assert found[0] @ vector[0] == pytest.approx(vector[0])  # its own axis stays
    assert np.trace(found[0]) == pytest.approx(1.0 + 2.0 * math.cos(math.sqrt(0.0725)), abs=1e-5)
    assert found[0][2, 1] - found[0][1, 2] > 0.0 > found[0][0, 2] - found[0][2, 0]


def test_a_level_frame_is_carried_along_by_the_gyro() -> None:
    time = np.arange(0.0, 2.001, 0.01)
    yaw = 0.8 * (time - 1.0)
    rate = np.tile([0.0, 0.0, 0.8], (time.size, 1))
    found = _carried(time, rate, np.array([0.0, 0.0, 1.0]), 100)
    assert found[100] == pytest.approx(np.eye(3))
    assert found[:, 0, 0] == pytest.approx(np.cos(yaw), abs=1e-6)
    assert found[:, 1, 0] == pytest.approx(np.sin(yaw), abs=1e-6)  # nose to the right
    down = np.array([-math.sin(0.2), 0.0, math.cos(0.2)])
    leaning = _carried(time, 0.0 * rate, down, 7)
    assert leaning[0] @ down == pytest.approx([0.0, 0.0, 1.0]) and leaning[-1] == pytest.approx(leaning[0])
    assert np.linalg.det(leaning[3]) == pytest.approx(1.0)
    assert leaning[0][1] == pytest.approx([0.0, 1.0, 0.0])  # its right is level


def test_the_integral_is_the_trapezoids() -> None:
    time = np.array([0.0, 1.0, 3.0, 3.5])
    assert integral(time, np.array([[2.0, 0.0], [4.0, 1.0], [0.0, 1.0], [8.0, 1.0]])) == pytest.approx(
        np.array([[0.0, 0.0], [3.0, 0.5], [7.0, 2.5], [9.0, 3.0]])
    )
    assert integral(time, np.ones((4, 2, 3)))[-1] == pytest.approx(np.full((2, 3), 3.5))


def test_white_noise_is_seen_beside_smooth_motion() -> None:
    chance = np.random.default_rng(5)
    values = (
        chance.normal(size=(4000, 3)) * [1.0, 2.0, 0.0] + 30.0 * np.sin(TIME[:1000].repeat(4))[:, None] * 0.1
    )
    time = 0.04 * np.arange(4000)
    assert white_noise(time, values)[:2] == pytest.approx([1.0, 2.0], rel=0.06)
    assert white_noise(time, values, quantile=0.25)[:2] == pytest.approx([1.0, 2.0], rel=0.08)
    assert white_noise(TIME, np.outer(TIME, [1.0, 2.0, 3.0])) == pytest.approx(np.full(3, 1e-9), abs=1e-9)


def test_noise_behind_a_filter_adds_up_as_it_did_before_it() -> None:
    white = np.random.default_rng(5).normal(size=(20_000, 1))
    filtered = (white[:-3] + white[1:-2] + white[2:-1] + white[3:]) / 4.0
    time = 0.004 * np.arange(len(filtered))
    assert white_noise(time, filtered) == pytest.approx([1.0], rel=0.2)
    # Neighbours alone show a third of it.
    assert white_noise(10.0 * time, filtered) < 0.4


def test_noise_walks_knot_by_knot_and_turns_with_the_vehicle() -> None:
    time = np.arange(0.0, 4.001, 0.1)
    rotation = np.tile(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (time.size, 1, 1))
    walks, sigma = _walks(time, rotation, np.array([0.3, 0.5, 9.0]), 0.0)
    assert walks.shape == (time.size, 2, 8)
    # Four knots of a second; in each what is added is one step, along the turned axes.
    assert walks[-1, 1, :4] == pytest.approx(np.ones(4), abs=0.06)
    assert walks[-1, 0, 4:] == pytest.approx(-np.ones(4), abs=0.06)
    assert np.abs(walks[:, 0, :4]).max() < 1e-12 and walks[10, 1, 1:4] == pytest.approx(np.zeros(3), abs=0.06)
    assert sigma == pytest.approx([0.3 * math.sqrt(0.1)] * 4 + [0.5 * math.sqrt(0.1)] * 4)
    # Noise far below the step of whole numbers hides the step's share for a knot.
    _, whole = _walks(time, rotation, np.array([0.3, 0.5, 9.0]), 100.0)
    assert whole == pytest.approx([100.0 / math.sqrt(12.0)] * 8, rel=3e-3)
    assert _walks(time[:4], rotation[:4], np.ones(3), 0.0)[0].shape == (4, 2, 2)  # at least one knot


def test_a_tilt_error_begins_in_the_middle_and_drifts() -> None:
    time = np.arange(0.0, 4.001, 0.1)
    rotation = np.tile(np.eye(3), (time.size, 1, 1))
    rate = 0.02 * np.random.default_rng(2).normal(size=(time.size, 3))
    phi, sigma = _tilt_errors(time, rotation, rate, 20, 0.0)
    assert phi.shape == (time.size, 2, 2 + 3 + 8) and sigma.size == 13
    assert phi[20, :, 2:] == pytest.approx(np.zeros((2, 11))) and phi[7, :, :2] == pytest.approx(np.eye(2))
    assert phi[-1, :, 2:5] == pytest.approx(np.eye(3)[:2] * 2.0) and phi[0, :, 2:5] == pytest.approx(
        np.eye(3)[:2] * -2.0
    )
    assert sigma[:5] == pytest.approx([5.0 * DEG] * 2 + [0.2 * DEG] * 3)
    assert sigma[5:] == pytest.approx(np.repeat(white_noise(time, rate)[:2], 4) * math.sqrt(0.1))


def test_cosine_and_sine_are_bound_to_their_circle() -> None:
    sharp = np.diag([4.0, 1e-4, 1e-4])
    sharp[0, 1] = sharp[1, 0] = 0.01  # the first unknown goes with the cosine
    state, covariance = _on_the_circle(np.array([1.0, 0.9, 0.0]), sharp)
    assert state[1:] == pytest.approx([1.0, 0.0], abs=0.01)
    assert state[0] == pytest.approx(1.0 + 100.0 * 0.1, rel=0.02)
    assert covariance[0, 0] == pytest.approx(4.0 - 1.0, abs=0.1)
    unknown = np.diag([4.0, 100.0, 100.0])
    state, covariance = _on_the_circle(np.array([1.0, 0.1, 0.0]), unknown)
    assert np.hypot(*state[1:]) < 0.05 and covariance[1, 1] == pytest.approx(0.5, abs=0.02)
    assert covariance[0, 0] == pytest.approx(4.0)


def test_the_equations_are_solved_for_what_leans() -> None:
    time = np.arange(0.0, 10.001, 0.1)
    leaning = np.zeros((time.size, 2, 2))
    leaning[:, 0, 0] = leaning[:, 1, 1] = G * time
    leaning[:, 0, 0] *= -1.0
    true, angle = np.array([0.01, -0.02]), 0.7
    pushed = np.stack([2.0 * np.sin(time), np.cos(time)], axis=1)
    level = pushed + leaning @ true + [0.3, -0.4]
    c, s = math.cos(angle), math.sin(angle)
    north_east = level @ np.array([[c, -s], [s, c]]).T
    known = _Velocity(time[::5], north_east[::5], 0.1)
    state, covariance = _solve(time, known, leaning, np.full(2, 0.1), pushed)
    assert state == pytest.approx(true, abs=2e-4)
    # The slope of 21 velocities of 0.1 m/s over ten seconds; a start and an angle are found beside it.
    slope = 0.1 / math.sqrt(float(((time[::5] - 5.0) ** 2).sum())) / G
    assert np.sqrt(np.diag(covariance)) == pytest.approx([slope] * 2, rel=0.35)
    doubled = _Velocity(
        known.time_s, north_east[::5] + 0.4 * np.random.default_rng(1).normal(size=(21, 2)), 0.1
    )
    _, wider = _solve(time, doubled, leaning, np.full(2, 0.1), pushed)
    assert np.sqrt(wider[0, 0] / covariance[0, 0]) == pytest.approx(4.0, rel=0.35)  # as large as the misfit


def test_what_is_known_of_the_velocity() -> None:
    hover = _velocity(recording(), TIME, True)
    assert hover is not None and hover.sigma_mps == 0.3 and not hover.mps.any()
    assert hover.time_s.tolist() == [float(k) for k in range(24)]
    assert _velocity(recording(), TIME, False) is None
    told = _velocity(recording(gps_velocity_mps=moving((1.0, 2.0))), TIME, True)
    assert told is not None and told.mps[0] == pytest.approx([1.0, 2.0])
    # 0.1 m/s each second: five in a second tell no more than one.
    assert told.sigma_mps == pytest.approx(0.1 * math.sqrt(told.time_s.size / 24.0))
    assert told.time_s[0] == pytest.approx(0.2 - 0.11)  # a receiver is late
    # What the receiver measured counts before what a filter made of it, as long as there is enough of it.
    for every_s, east in ((0.2, 5.0), (2.0, 2.0)):
        measured = moving((1.0, 5.0), every_s=every_s)
        both = recording(gps_velocity_mps=moving((1.0, 2.0)), receiver_velocity_mps=measured)
        chosen = _velocity(both, TIME, True)
        assert chosen is not None and chosen.mps[0, 1] == pytest.approx(east)
    slow = _velocity(recording(vehicle="plane", gps_velocity_mps=moving(every_s=1.15)), TIME, False)
    assert slow is not None and slow.sigma_mps == 0.1
    assert _velocity(recording(vehicle="plane", gps_velocity_mps=moving(every_s=1.3)), TIME, False) is None
    unknown = moving()
    unknown.values[5:] = np.nan
    assert _velocity(recording(vehicle="plane", gps_velocity_mps=unknown), TIME, False) is None


@pytest.mark.parametrize(
    ("gap_s", "at_s", "tells"), [(0.6, 12.0, False), (0.4, 12.0, True), (0.6, 8.0, True), (0.6, 16.0, True)]
)
def test_a_gap_cuts_what_is_looked_at(gap_s: float, at_s: float, tells: bool) -> None:
    kept = (TIME < at_s) | (TIME > at_s + gap_s)
    track = recording()
    assert track.gyro_radps is not None
    holed = replace(track, gyro_radps=Series.of(TIME[kept], track.gyro_radps.values[kept]))
    found = _samples(holed, START_S, END_S)
    assert (found is not None) is tells
    if found is not None and gap_s > 0.5:
        time = found[0]
        assert time[0] == pytest.approx(8.62 if at_s < 11.0 else 1.0, abs=0.03)
        assert time[-1] == pytest.approx(22.98 if at_s < 11.0 else 16.0, abs=0.03)


def test_what_is_looked_at_lasts_from_ten_seconds_before_to_ten_after() -> None:
    found = _samples(recording(), START_S, END_S)
    assert found is not None
    assert found[0][0] == pytest.approx(1.0) and found[0][-1] == pytest.approx(22.98)
    assert _samples(recording(), -5.0, 1.0) is None and _samples(recording(), 23.0, 25.0) is None
    assert _samples(Track(gyro_radps=Series.of(TIME, np.zeros((TIME.size, 3)))), START_S, END_S) is None
    few = recording()
    assert few.gyro_radps is not None
    for every, tells in ((22, True), (24, True), (26, False)):  # half a second is a gap
        thin = replace(few, gyro_radps=Series.of(TIME[::every], few.gyro_radps.values[::every]))
        assert (_samples(thin, START_S, END_S) is not None) is tells
    twice = np.sort(np.concatenate([TIME, TIME]))
    again = replace(few, gyro_radps=Series.of(twice, np.zeros((twice.size, 3))))
    whole = _samples(again, START_S, END_S)
    assert whole is not None and np.diff(whole[0]).min() > 0.0
    broken = recording()
    assert broken.acc_mps2 is not None
    broken.acc_mps2.values[600:603] = np.nan
    left = _samples(broken, START_S, END_S)
    assert left is not None and np.isfinite(left[2]).all()


def test_numbers_cut_toward_zero_are_put_right() -> None:
    rate = np.tile([0.01, -0.02, 0.0], (TIME.size, 1))
    track = recording(rate=rate, acc_truncation_mps2=0.02, gyro_truncation_radps=0.001)
    found = _samples(track, START_S, END_S)
    assert found is not None
    assert found[1][0] == pytest.approx([0.0105, -0.0205, 0.0]) and found[2][0] == pytest.approx(
        [0.0, 0.0, -G - 0.01]
    )


def test_a_change_of_the_acceleration_shows_how_far_its_mean_may_be_off() -> None:
    level = np.zeros((90, 3))
    level[:30, 0], level[60:, 0], level[:, 1] = 0.02 * G, -0.01 * G, 7.0
    jumps = np.diff(level[:, :2] / G, axis=0)
    chance2 = 4.0 * (jumps**2).mean() / 2.0 * 3.0 / 90.0
    assert _swing(level) == pytest.approx(8.0 * math.sqrt(0.03**2 - chance2))
    assert _swing(np.zeros((6, 3))) == 0.0 and _swing(np.zeros((5, 3))) == math.inf
    noisy = np.random.default_rng(1).normal(0.0, 0.1, (900, 3))
    assert _swing(noisy) == 0.0  # shaking averages out


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(3.0, 0.0), (0.0, -4.0), (2.0, 2.0)])
def test_a_steady_lean_is_found_to_its_sigma(velocity: bool, roll_deg: float, pitch_deg: float) -> None:
    """It stands in the air, leans by its trim, and its gyro drifts: the estimator says level."""
    roll, pitch = roll_deg * DEG, pitch_deg * DEG
    body = np.reshape(rotation_matrix(roll, pitch, 1.0), (3, 3)).T
    force = np.tile(body @ [0.0, 0.0, -G], (TIME.size, 1))
    rate = np.tile([0.05 * DEG, -0.05 * DEG, 0.1 * DEG], (TIME.size, 1))
    noise = np.random.default_rng(4).normal(size=(2, TIME.size, 3))
    level = Series.of(TIME, np.zeros((TIME.size, 3)))
    track = recording(
        force + 0.1 * noise[0], rate + 0.002 * noise[1], attitude_rad=level,
        gps_velocity_mps=moving() if velocity else None,
    )  # fmt: skip
    found = sway(track, START_S, END_S)
    assert found is not None
    x, y, z = found.down
    off = np.array([math.atan2(y, z) - roll, -math.asin(x) - pitch])
    assert np.abs(off).max() < 3.0 * found.sigma_rad
    assert found.sigma_rad / DEG == pytest.approx(0.06 if velocity else 0.082, rel=0.1)
    assert np.linalg.norm(found.down) == pytest.approx(1.0) and found.swing_rad < 0.2 * DEG


@pytest.mark.parametrize(("count", "is_enough"), [(19, False), (20, True)])
def test_twenty_readings_are_the_fewest(count: int, is_enough: bool) -> None:
    whole = recording()
    assert whole.gyro_radps is not None
    few = replace(
        whole, gyro_radps=Series.of(TIME[545 : 545 + count], whole.gyro_radps.values[545 : 545 + count])
    )
    assert (_samples(few, 11.0, 11.1) is not None) is is_enough


def test_a_stretch_holds_the_readings_at_its_very_ends() -> None:
    found = level_by_newton(recording(), float(TIME[500]), float(TIME[600]), hovers=True)
    assert found is not None and found.time_s.tolist() == TIME[500:601].tolist()
    assert found.leaning.shape[:2] == (101, 2) and found.down().shape == (101, 3)
