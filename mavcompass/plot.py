"""What the reports show, as matplotlib figures for a notebook: circle, deviation, residuals, waterfall.

    from mavcompass import plot

    plot.circle(track, result)
    plot.deviation(result)

Each draws into `ax`, or into axes of its own, and returns them. Needs the extra `report`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mavcompass.calibration.result import CalibrationResult
from mavcompass.installation.parts import require
from mavcompass.report.figures import (
    circle_points,
    level_components,
    position_residuals_deg,
    sigma_deg,
)
from mavcompass.track import Track

require("A plot")

import matplotlib.pyplot as plt  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402

if TYPE_CHECKING:
    from mavcompass.gap.result import Diagnosis

_OLD, _NEW, _EARTH, _STEP = "#c2410c", "#0f766e", "#94a3b8", "#6366f1"


def circle(track: Track, result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw the level field before and after, forward up and right to the right, with the Earth's circle."""
    ax = _axes(ax, (5.0, 5.0))
    for correction, colour, name in (
        (result.in_force, _OLD, "before"),
        (result.correction, _NEW, "after"),
    ):
        points = circle_points(track, result, correction)
        ax.plot(points[:, 1], points[:, 0], ".", color=colour, markersize=2.5, label=name)
    if math.isfinite(result.horizontal_mgauss):
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        radius = result.horizontal_mgauss
        ax.plot(
            radius * np.sin(turn), radius * np.cos(turn), color=_EARTH, linewidth=1.0, label="the Earth's"
        )
    if result.positions:
        means = result.correction.apply(np.array([p.mean_mgauss for p in result.positions]))
        stops = level_components(means, np.tile([0.0, 0.0, 1.0], (len(means), 1)))
        ax.plot(stops[:, 1], stops[:, 0], "o", color=_NEW, markerfacecolor="none", label="positions")
    ax.set(xlabel="to the right, mG", ylabel="forward, mG", title="Level field as the vehicle turned")
    ax.set_aspect("equal", "datalim")
    ax.legend(loc="upper right", markerscale=2.0)
    return ax


def deviation(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw the old calibration's heading error over the circle, and the sigma of the new one."""
    ax = _axes(ax)
    heading = np.arange(73) * 5.0
    sigma = sigma_deg(result, heading)
    ax.fill_between(heading, -sigma, sigma, color=_NEW, alpha=0.25, label="new calibration, 1 sigma")
    if (old := result.in_force_error_deg()) is not None:
        ax.plot(heading, np.append(old, old[0]), color=_OLD, label="old calibration")
    _over_the_circle(ax, "error, deg", "Heading error over the circle")
    ax.legend()
    return ax


def residuals(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """Draw what the fit leaves over at each position, if there were any, within the predicted sigma."""
    ax = _axes(ax)
    heading = np.arange(73) * 5.0
    sigma = sigma_deg(result, heading)
    ax.fill_between(heading, -sigma, sigma, color=_NEW, alpha=0.25, label="1 sigma")
    where, left_over = position_residuals_deg(result)
    if len(where):
        ax.plot(np.mod(where, 360.0), left_over, "o", color=_OLD, label="positions")
    _over_the_circle(ax, "residual, deg", "What the fit leaves over")
    ax.legend()
    return ax


def waterfall(diagnosis: Diagnosis, ax: Axes | None = None) -> Axes:
    """Draw the gap between simulation and recording as it falls with each effect, down to the floor."""
    ax = _axes(ax)
    closing = diagnosis.field
    names, level = ["simulation as it is"], closing.nominal**2
    ax.bar(0, closing.nominal, color=_OLD)
    for place, step in enumerate(diagnosis.waterfall, start=1):
        upper, level = math.sqrt(max(level, 0.0)), max(level - step.part_mgauss2, 0.0)
        ax.bar(place, upper - math.sqrt(level), bottom=math.sqrt(level), color=_STEP)
        names.append(step.effect)
    ax.bar(len(names), closing.after, color=_NEW)
    names.append("with these effects")
    ax.axhline(closing.floor, color=_EARTH, linestyle="--", label="noise floor")
    ax.set_xticks(range(len(names)), names, rotation=20, ha="right")
    ax.set(ylabel="gap, mG rms", title="What closes the gap")
    ax.legend()
    return ax


def _axes(ax: Axes | None, size: tuple[float, float] = (7.0, 3.2)) -> Axes:
    return plt.subplots(figsize=size, layout="constrained")[1] if ax is None else ax


def _over_the_circle(ax: Axes, label: str, title: str) -> None:
    ax.axhline(0.0, color=_EARTH, linewidth=0.8)
    ax.set(xlabel="heading, deg", ylabel=label, title=title, xlim=(0.0, 360.0), xticks=range(0, 361, 45))
