"""The published formulas, number by number."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.methods._level import LevelCompensation
from mavcompass.calibration.methods.four_positions_textbook import four_positions_textbook, four_readings
from mavcompass.calibration.methods.min_max import min_max, set_reset_offset
from mavcompass.calibration.methods.sensitivity_bias import sensitivity_bias
from mavcompass.errors import PoorCalibration

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
