"""The papers' formulas together, the next pose, the deviation card, and rest seen through noise."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from calibration_worlds import four_positions, iron_of
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.calibration import StillnessDetector, calibrate_positions
from mavcompass.calibration.methods._level import LevelCompensation
from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook, four_readings
from mavcompass.calibration.methods.min_max import min_max, set_reset_offset
from mavcompass.calibration.methods.sensitivity_bias import sensitivity_bias
from mavcompass.calibration.observation.detector import Stillness
from mavcompass.calibration.positions import next_pose
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.heading.deviation import deviation_card

STRONG = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0))


# ---- the papers ----


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


def test_the_card_shows_the_irons() -> None:
    card = deviation_card(FieldCorrection(), FieldCorrection((-20.0, 0.0, 0.0)), 200.0, -400.0)
    assert card.coefficients_deg["B"] == pytest.approx(math.degrees(20.0 / 200.0), rel=0.02)
    assert abs(card.coefficients_deg["C"]) < 0.05
    # It shows east where the field's part along the vehicle is just what the iron takes away.
    assert card.compass_deg[2] == 90.0
    assert card.deviation_deg[2] == pytest.approx(math.degrees(math.asin(20.0 / 200.0)), abs=0.01)


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
    assert noisy.averaging_s(math.radians(0.35), 2.0) == 0.0
    for time_s, gyro, force, field in noisy_readings(0.0):
        noisy.update(time_s, gyro, force, field)
        quiet.update(time_s, gyro, (0.0, 0.0, -9.81), (200.0, 0.0, 430.0))
    assert quiet.averaging_s(math.radians(0.35), 2.0) == 0.0
    # One component's noise is 0.92 m/s^2: 0.094 / 0.0061 squared makes 236 readings at 50 Hz.
    assert noisy.averaging_s(math.radians(0.35), 2.0) == pytest.approx(4.7, rel=0.25)
    assert noisy.averaging_s(math.radians(0.175), 1.0) == pytest.approx(
        4.0 * noisy.averaging_s(math.radians(0.35), 2.0)
    )


# --- The published formulas, number by number


RAW = np.array([[100.0, -40.0, 7.0], [-300.0, 90.0, 7.0]])


def test_an_offset_is_half_the_sum_of_set_and_reset() -> None:
    assert set_reset_offset([212.0, -3.0], [-188.0, 5.0]).tolist() == [12.0, 1.0]


@pytest.mark.parametrize("alpha", [0.0, 0.7, 2.0, 3.9, -1.0])
def test_four_readings_of_a_sine_give_its_amplitude_offset_and_angle(alpha: float) -> None:
    readings = 150.0 * np.sin(alpha + np.arange(4) * 0.5 * math.pi) + 40.0
    solved = four_readings(readings)
    assert solved.amplitude == pytest.approx(150.0) and solved.offset == pytest.approx(40.0)
    assert math.remainder(solved.alpha_rad - alpha, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert solved.left_over == pytest.approx(0.0, abs=1e-12)
    spoilt = readings + np.array([0.0, 8.0, 0.0, 0.0])
    assert four_readings(spoilt).left_over == pytest.approx(-2.0)
    assert four_readings(spoilt).offset == pytest.approx(42.0)
    assert four_readings(readings + np.array([4.0, 0.0, 8.0, 0.0])).left_over == pytest.approx(3.0)


def test_a_compensation_is_a_correction() -> None:
    form = LevelCompensation((1.5, 1.0), (-30.0, 20.0))
    expected = [[1.5 * 100.0 - 30.0, -40.0 + 20.0], [1.5 * -300.0 - 30.0, 90.0 + 20.0]]
    assert form.apply(RAW).tolist() == expected
    correction = form.correction()
    assert correction.apply(RAW)[:, :2] == pytest.approx(np.array(expected))
    assert correction.apply(RAW)[:, 2].tolist() == [7.0, 7.0]
    assert form.correction(-3.0, 2.0).apply(RAW)[:, 2].tolist() == [8.0, 8.0]


def test_the_weaker_axis_is_scaled_up_about_the_middle_of_its_extremes() -> None:
    turn = np.array([[10.0, -50.0], [210.0, 0.0], [110.0, 50.0], [60.0, -150.0]])
    found = min_max(turn)
    assert found == LevelCompensation((1.0, 1.0), (-110.0, 50.0))
    weak = min_max(turn * [0.5, 1.0])
    assert weak.gain == (2.0, 1.0) and weak.bias[0] == -2.0 * 55.0
    assert min_max(turn * [1.0, 0.5]).gain == (1.0, 2.0)


@pytest.mark.parametrize(
    ("unity", "x_sensitivity", "y_sensitivity"), [("stronger", 1.0, 2.0), ("x", 1.0, 2.0), ("y", 0.5, 1.0)]
)
def test_sensitivities_bring_both_spans_together(
    unity: str, x_sensitivity: float, y_sensitivity: float
) -> None:
    found = sensitivity_bias(10.0, 210.0, -150.0, -50.0, unity)  # type: ignore[arg-type]
    assert found.gain == (x_sensitivity, y_sensitivity)
    ends = found.apply([[10.0, -150.0], [210.0, -50.0]])
    assert ends[0] == pytest.approx(-ends[1]) and ends[1, 0] == ends[1, 1]
    swapped = sensitivity_bias(-150.0, -50.0, 10.0, 210.0)
    assert swapped.gain == (2.0, 1.0)


def test_an_axis_that_does_not_change_has_no_scale() -> None:
    for axis in (0, 1):
        flat = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 1.0], [2.0, 0.0]])
        flat[:, axis] = 5.0
        for solve in (min_max, four_positions_textbook):
            with pytest.raises(PoorCalibration, match="did not change at all"):
                solve(flat)
    for extremes in ((1.0, 1.0, 0.0, 2.0), (0.0, 2.0, 1.0, 1.0)):
        with pytest.raises(PoorCalibration, match="did not change at all"):
            sensitivity_bias(*extremes)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_the_unit_does_not_matter(size: float) -> None:
    """Gauss, milligauss, or the counts of a sensor."""
    turn = size * np.array([[-0.284, 0.0], [0.402, 0.0], [0.0, -0.322], [0.0, 0.246]])
    found = min_max(turn)
    assert found.gain == pytest.approx((1.0, 0.686 / 0.568))
    assert found.bias[0] == pytest.approx(-0.059 * size)
    memsense = sensitivity_bias(*(size * np.array([-0.284, 0.402, -0.322, 0.246])))
    assert memsense.gain == pytest.approx((1.0, 0.686 / 0.568))
    assert memsense.bias == pytest.approx((-0.059 * size, 0.0459 * size), rel=2e-3)


def test_of_axes_that_are_alike_either_is_one() -> None:
    for unity in ("stronger", "x", "y"):
        found = sensitivity_bias(-1.0, 3.0, 5.0, 9.0, unity)  # type: ignore[arg-type]
        assert found == LevelCompensation((1.0, 1.0), (-1.0, -7.0))
