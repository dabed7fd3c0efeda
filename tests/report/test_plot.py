"""Plots for a notebook show what was calibrated and diagnosed."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import mavcompass
from mavcompass.calibration.result import CalibrationResult
from mavcompass.track import Track


@pytest.fixture(scope="module")
def recorded() -> tuple[Track, CalibrationResult]:
    """Calibrate a simulated boat and keep its recording."""
    with mavcompass.connect("sim:boat,seed=7") as vehicle:
        report = vehicle.calibrate()
    return report.track, report.results[0]


@pytest.fixture
def plot() -> Iterator[ModuleType]:
    """The module, which loads matplotlib; its figures are closed."""
    pytest.importorskip("matplotlib", reason="pip install 'mavcompass[report]'").use("Agg")
    module = importlib.import_module("mavcompass.plot")
    yield module
    module.plt.close("all")


def test_the_circle_after_the_calibration_is_the_earth_s(
    plot: Any, recorded: tuple[Track, CalibrationResult]
) -> None:
    track, result = recorded
    before, after, earth, positions = plot.circle(track, result).get_lines()
    radius = np.hypot(*after.get_data())
    assert np.median(radius) == pytest.approx(result.horizontal_mgauss, rel=0.05)
    assert np.ptp(np.hypot(*before.get_data())) > 5.0 * np.std(radius)
    assert np.hypot(*earth.get_data()) == pytest.approx(result.horizontal_mgauss)
    assert len(positions.get_xdata()) == len(result.positions)


def test_the_deviation_is_the_change_of_heading(plot: Any, recorded: tuple[Track, CalibrationResult]) -> None:
    old = np.asarray(plot.deviation(recorded[1]).get_lines()[0].get_ydata(), dtype=float)
    assert np.sqrt(np.mean(old[:-1] ** 2)) == pytest.approx(recorded[1].heading_change_deg, rel=0.02)


def test_residuals_are_one_for_each_position_in_axes_that_are_given(
    plot: Any, recorded: tuple[Track, CalibrationResult]
) -> None:
    _, ax = plot.plt.subplots()
    assert plot.residuals(recorded[1], ax) is ax
    assert any(len(line.get_xdata()) == len(recorded[1].positions) for line in ax.get_lines())


def test_the_waterfall_ends_at_what_is_left(plot: Any, recorded: tuple[Track, CalibrationResult]) -> None:
    diagnosis = mavcompass.diagnose_gap(recorded[0])
    bars = plot.waterfall(diagnosis).patches
    assert bars[0].get_height() == pytest.approx(diagnosis.field.nominal)
    assert bars[-1].get_height() == pytest.approx(diagnosis.field.after)
    assert len(bars) == 2 + len(diagnosis.waterfall)
