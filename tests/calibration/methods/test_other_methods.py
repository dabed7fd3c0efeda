"""The papers' formulas, the wire, the all-round fits, and what is said about mounting and repetition."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, body_field, four_positions, iron_of, rms
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.calibration import StillnessDetector, calibrate_positions
from mavcompass.calibration.fits.length import fit_ellipsoid, fit_sphere
from mavcompass.calibration.fits.textbook import (
    four_positions_textbook,
    four_readings,
    min_max,
    sensitivity_bias,
    set_reset_offset,
)
from mavcompass.calibration.observation.detector import Stillness
from mavcompass.calibration.observation.wire import effective_count, unquantise
from mavcompass.calibration.positions import next_pose, repeat_test
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.heading.deviation import deviation_card, fit_deviation

STRONG = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0))


# ---- the papers ----


def test_set_and_reset_leave_the_offset() -> None:
    assert set_reset_offset(12.0 + 200.0, 12.0 - 200.0) == 12.0


def test_the_bicycle_comes_out_as_printed() -> None:
    bicycle = sensitivity_bias(-0.284, 0.402, -0.322, 0.246)
    printed = (bicycle.x_sensitivity, bicycle.x_bias, bicycle.y_sensitivity, bicycle.y_bias)
    assert [round(v, 3) for v in printed] == [1.0, -0.059, 1.208, 0.046]


def test_either_axis_may_keep_the_sensitivity_of_one() -> None:
    by_y = sensitivity_bias(-0.284, 0.402, -0.322, 0.246, unity="y")
    assert by_y.y_sensitivity == 1.0
    assert by_y.x_sensitivity == pytest.approx(0.568 / 0.686)
    extremes = by_y.apply([[-0.284, -0.322], [0.402, 0.246]])
    assert np.allclose(extremes[0], -extremes[1])


@given(
    ax=st.floats(50.0, 400.0),
    ay=st.floats(50.0, 400.0),
    cx=st.floats(-300.0, 300.0),
    cy=st.floats(-300.0, 300.0),
    alpha=st.floats(-3.14, 3.14),
)
def test_all_textbook_methods_centre_and_round_an_ellipse(
    ax: float, ay: float, cx: float, cy: float, alpha: float
) -> None:
    angle = alpha + np.arange(4) * math.pi / 2
    readings = np.column_stack([cx + ax * np.cos(angle), cy - ay * np.sin(angle)])
    four, axes = four_positions_textbook(readings)
    assert np.allclose([a.left_over for a in axes], 0.0, atol=1e-9)
    circle = np.arange(360) * math.pi / 180
    turn = np.column_stack([cx + ax * np.cos(circle), cy - ay * np.sin(circle)])
    corrected = four.apply(turn)
    assert np.allclose(np.hypot(*corrected.T), max(ax, ay))
    assert np.allclose(min_max(turn).apply(turn), corrected, atol=1e-6 * max(ax, ay))
    assert np.allclose(four.correction().apply(np.column_stack([turn, 0 * circle]))[:, :2], corrected)


def test_the_amplitude_does_not_divide_by_zero() -> None:
    solved = four_readings([5.0, 105.0, 5.0, -95.0])  # alpha = 0: the printed A is 0 / 0
    assert (solved.amplitude, solved.offset, solved.alpha_rad) == (100.0, 5.0, 0.0)


def test_wrong_steps_show_in_the_left_over_equation() -> None:
    angle = 0.3 + np.radians([0.0, 95.0, 180.0, 270.0])
    readings = np.column_stack([200 * np.cos(angle), -200 * np.sin(angle)])
    _, axes = four_positions_textbook(readings)
    assert max(abs(a.left_over) for a in axes) > 3.0


def test_an_axis_that_does_not_move_is_refused() -> None:
    with pytest.raises(PoorCalibration):
        min_max([[1.0, 5.0], [1.0, 9.0]])


# ---- the wire ----


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.6, 2.0])
@pytest.mark.parametrize("truncated", [True, False])
def test_whole_numbers_are_taken_back(noise: float, truncated: bool) -> None:
    rng = np.random.default_rng(8)
    errors, claims = [], []
    for _ in range(300):
        true = rng.uniform(-300, 300, 3)
        readings = true + rng.normal(0, noise, (400, 3))
        whole = np.trunc(readings) if truncated else np.round(readings)
        value, sigma = unquantise(whole.mean(axis=0), whole.std(axis=0), 1.0, truncated)
        errors.append(value - true)
        claims.append(np.hypot(sigma, whole.std(axis=0) / 20.0))
    ratio = rms(np.array(errors)) / rms(np.array(claims))
    assert 0.7 < ratio < 1.25
    assert abs(np.mean(errors)) < 0.06


def test_truncation_around_zero_is_known_to_be_unknown() -> None:
    value, sigma = unquantise(np.zeros(3), np.zeros(3), 1.0, True)
    assert np.allclose(value, 0.0) and np.allclose(sigma, 1.0 / math.sqrt(3.0))


def test_repeated_readings_count_once() -> None:
    values = np.repeat(np.arange(12.0).reshape(4, 3), 5, axis=0)
    fresh, count = effective_count(values)
    assert count == 4 and fresh.sum() == 4


# ---- all-round and world-field ----


def all_ways(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rotation = euler_to_matrix(
        rng.uniform(-1, 1, count), rng.uniform(-1, 1, count), rng.uniform(-3.1, 3.1, count)
    )
    return rotation, rotate_back(rotation, np.broadcast_to(FIELD.vector_mgauss, (count, 3)))


def test_an_ellipsoid_is_found_from_any_motion() -> None:
    _, field = all_ways(3000)
    iron = Iron((120.0, -60.0, 30.0), np.array([[1.1, 0.03, -0.02], [0.03, 0.9, 0.04], [-0.02, 0.04, 1.05]]))
    raw = iron.raw(field) + np.random.default_rng(1).normal(0, 2.0, field.shape)
    fit = fit_ellipsoid(raw, FIELD.total_mgauss)
    assert np.allclose(fit.centre_mgauss, iron.offset, atol=1.0)
    assert np.allclose(fit.matrix @ iron.gain, np.eye(3), atol=3e-3)
    assert fit.residual_rms_mgauss == pytest.approx(2.0, rel=0.1)
    assert (np.abs(fit.centre_mgauss - iron.offset) < 4 * np.sqrt(np.diag(fit.covariance))[:3]).all()


def test_a_sphere_is_found_in_spite_of_outliers() -> None:
    _, field = all_ways(2000)
    raw = field + np.random.default_rng(1).normal((50.0, 20.0, -70.0), 2.0, field.shape)
    raw[::50] += 300.0
    fit = fit_sphere(raw)
    assert np.allclose(fit.centre_mgauss, (50.0, 20.0, -70.0), atol=2.0)


def test_a_flat_turn_is_no_sphere() -> None:
    with pytest.raises(PoorCalibration, match="plane"):
        fit_ellipsoid(body_field(np.linspace(0, 6.2, 500)))


# ---- observability, deviation, repetition, stillness ----


def test_a_tilted_pose_is_what_a_level_turn_lacks() -> None:
    data = four_positions(iron_of(STRONG), np.random.default_rng(1), noise=2.0, gyro_sigma=0.005)
    result = calibrate_positions(data, earth=None)
    assert "offset_z" in result.not_observable or any("Z stays" in w for w in result.warnings)
    free, level = next_pose(data), next_pose(data, may_tilt=False)
    assert (free.roll_rad, free.pitch_rad) != (0.0, 0.0)
    assert (level.roll_rad, level.pitch_rad) == (0.0, 0.0)
    assert free.sigma_tilted_rad < level.sigma_tilted_rad
    assert all(math.degrees(p.turn_rad) % 45.0 == pytest.approx(0.0, abs=1e-9) for p in (free, level))
    assert math.degrees(max(abs(free.roll_rad), abs(free.pitch_rad))) == pytest.approx(15.0)


@given(b=st.floats(-8, 8), c=st.floats(-8, 8), d=st.floats(-3, 3), e=st.floats(-3, 3), a=st.floats(-5, 5))
@settings(max_examples=50)
def test_the_five_coefficients_come_back(a: float, b: float, c: float, d: float, e: float) -> None:
    compass = np.arange(16) * math.pi / 8
    deviation = (
        a + b * np.sin(compass) + c * np.cos(compass) + d * np.sin(2 * compass) + e * np.cos(2 * compass)
    )
    card = fit_deviation(compass, compass + np.radians(deviation))
    assert np.allclose(list(card.coefficients_deg.values()), [a, b, c, d, e], atol=1e-9)


def test_the_card_shows_the_irons() -> None:
    card = deviation_card(FieldCorrection(), FieldCorrection((-20.0, 0.0, 0.0)), 200.0, -400.0)
    assert card.coefficients_deg["B"] == pytest.approx(math.degrees(20.0 / 200.0), rel=0.02)
    assert abs(card.coefficients_deg["C"]) < 0.05
    # It shows east where the field's part along the vehicle is just what the iron takes away.
    assert card.compass_deg[2] == 90.0
    assert card.deviation_deg[2] == pytest.approx(math.degrees(math.asin(20.0 / 200.0)), abs=0.01)


def back_and_forth(seed: int = 4):
    rng = np.random.default_rng(seed)
    iron = iron_of(STRONG)
    forward = four_positions(iron, rng, noise=1.0, gyro_sigma=0.003)
    last = 0.4 + 3 * math.pi / 2
    backward = four_positions(
        iron, rng, first=last, turns=-np.full(3, math.pi / 2), noise=1.0, gyro_sigma=0.003
    )
    return forward, backward


def test_a_turn_back_that_repeats_is_said_to() -> None:
    forward, backward = back_and_forth()
    test = repeat_test(forward, backward, earth=FIELD)
    assert test.cause == "repeats"
    assert test.heading_rms_rad < math.radians(0.5)


def test_passing_steel_is_told_from_hysteresis() -> None:
    forward, backward = back_and_forth()
    dwells = list(backward.dwells)
    dwells[2] = replace(dwells[2], mean_mgauss=dwells[2].mean_mgauss + np.array([30.0, 30.0, 0.0]))
    test = repeat_test(forward, replace(backward, dwells=tuple(dwells)), earth=FIELD)
    assert (test.cause, test.position) == ("disturbance", 2)

    lagging = []
    for index, dwell in enumerate(backward.dwells):
        psi = 0.4 + 3 * math.pi / 2 - index * math.pi / 2
        late = iron_of(STRONG).raw(body_field(np.array([psi + math.radians(3.0) * (index > 0)])))[0]
        lagging.append(replace(dwell, mean_mgauss=late))
    test = repeat_test(forward, replace(backward, dwells=tuple(lagging)), earth=FIELD)
    assert test.cause == "hysteresis"
    assert test.hysteresis_rad == pytest.approx(math.radians(1.5), abs=math.radians(0.3))


def test_stillness_is_told_sample_by_sample() -> None:
    detector = StillnessDetector(hold_s=1.0)
    seen = []
    for k in range(400):
        time_s = 0.025 * k
        rate = 0.8 if 4.0 < time_s < 6.0 else 0.0
        state = detector.update(time_s, (0.0, 0.0, rate), (0.0, 0.0, -9.8), (200.0, 0.0, 400.0))
        seen.append((time_s, state))
    assert any(s.still for t, s in seen if t < 4.0)
    assert not any(s.still for t, s in seen if 4.3 < t < 6.8)
    assert {s.why_not for t, s in seen if 4.5 < t < 5.9} == {"rotating"}
    assert seen[-1][1].still
    assert seen[-1][1].turned_rad == pytest.approx(1.6, abs=0.05)
    late = detector.update(3.0, (0.0, 0.0, 9.0), (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert late.still


def test_a_rover_that_tips_is_not_still() -> None:
    detector = StillnessDetector(hold_s=0.5)
    for k in range(100):
        state = detector.update(0.02 * k, (0.5, 0.0, 0.0), (0.0, 0.0, -9.8), (200.0, 0.0, 400.0))
    assert not state.still and state.why_not == "tilting"


def noisy_readings(
    rocking_radps: float, jolt_mgauss: float = 0.0
) -> Iterator[tuple[float, FloatArray, FloatArray, FloatArray]]:
    """Give 10 s of a vehicle at rest, as PX4's own simulator shakes it: gyro, force, field at 50 Hz."""
    rng = np.random.default_rng(3)
    for k in range(500):
        gyro = rng.normal(0.0, (0.107, 0.05, 0.021))
        gyro[0] += rocking_radps * math.sin(2.0 * math.pi * 0.4 * 0.02 * k)
        force = rng.normal((0.0, 0.0, -9.81), (0.35, 1.2, 0.95))
        field = rng.normal((200.0 + (jolt_mgauss if k > 400 else 0.0), 0.0, 430.0), (20.0, 20.0, 30.0))
        yield 0.02 * k, gyro, force, field


def test_noise_is_no_unrest_and_unrest_is_seen_through_noise() -> None:
    def states(rocking_radps: float, jolt_mgauss: float = 0.0) -> list[Stillness]:
        detector = StillnessDetector(hold_s=0.0)
        return [detector.update(*reading) for reading in noisy_readings(rocking_radps, jolt_mgauss)][50:]

    assert np.mean([state.still for state in states(0.0)]) > 0.97
    assert np.mean([state.still for state in states(0.3)]) < 0.6
    begun = [state.since_s for state in states(0.0, jolt_mgauss=400.0)]
    assert 8.0 < begun[-1] < 8.1


def test_the_noisier_the_readings_the_longer_they_are_averaged() -> None:
    quiet, noisy = StillnessDetector(), StillnessDetector()
    for time_s, gyro, force, field in noisy_readings(0.0):
        noisy.update(time_s, gyro, force, field)
        quiet.update(time_s, gyro, (0.0, 0.0, -9.81), (200.0, 0.0, 430.0))
    assert quiet.averaging_s(math.radians(0.35), 2.0) == 0.0
    # One component's noise is 0.92 m/s^2: 0.094 / 0.0061 squared makes 236 readings at 50 Hz.
    assert noisy.averaging_s(math.radians(0.35), 2.0) == pytest.approx(4.7, rel=0.25)
    assert noisy.averaging_s(math.radians(0.175), 1.0) == pytest.approx(
        4.0 * noisy.averaging_s(math.radians(0.35), 2.0)
    )
