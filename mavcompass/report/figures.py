"""The figures of a calibration's report."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mavcompass.attitude import down_in_body
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.heading.compute import level_heading
from mavcompass.report.svg import Plot, bars, limits
from mavcompass.track import Track

_MOST_DOTS, _MOST_TURNING = 1500, 500
# From the vehicle's axes (forward, right, down) to the page's: 30 deg to the side, 20 deg from above.
_VIEW = euler_to_matrix(0.0, math.radians(20.0), 0.0) @ euler_to_matrix(0.0, 0.0, math.radians(30.0))
_VIEW = np.array([_VIEW[1], -_VIEW[2], -_VIEW[0]])
_COMPASS_TICKS = (0, 45, 90, 135, 180, 225, 270, 315, 360)
_BUDGET_NAMES = {
    "noise": "noise",
    "step_angle": "turn angles",
    "tilt": "tilt",
    "accelerometer": "accelerometer",
    "given_heading": "given heading",
    "world_model": "world model",
    "quantisation": "quantisation",
    "disturbance": "disturbance",
}


def level_components(field_mgauss: FloatArray, down: FloatArray) -> FloatArray:
    """Return the field along forward and right of the levelled vehicle, (N, 2), given down (N, 3)."""
    dx, dy, dz = down.T
    ahead = np.sqrt(np.maximum(dy**2 + dz**2, 1e-12))
    forward = field_mgauss[:, 0] * ahead - dx * (dy * field_mgauss[:, 1] + dz * field_mgauss[:, 2]) / ahead
    right = (dz * field_mgauss[:, 1] - dy * field_mgauss[:, 2]) / ahead
    return np.stack([forward, right], axis=1)


def circle_points(track: Track, result: CalibrationResult, correction: FieldCorrection) -> FloatArray:
    """Return the recording as a correction shows it, level, thinned out, (N, 2)."""
    raw, time_s = _thinned(track, result, _MOST_DOTS)
    return level_components(correction.apply(raw), down_in_body(track, time_s))


def _thinned(track: Track, result: CalibrationResult, most: int) -> tuple[FloatArray, FloatArray]:
    """Return raw readings, (N, 3), and their times."""
    raw = track.raw_field(result.instance)
    usable = np.isfinite(raw).all(axis=1)
    every = max(1, int(usable.sum()) // most)
    return raw[usable][::every], track.compasses[result.instance].time_s[usable][::every]


def sphere_figure(track: Track, result: CalibrationResult) -> str:
    """Draw the field in the vehicle's axes, before and after, and the sphere of the Earth's; it turns."""
    raw, _ = _thinned(track, result, _MOST_TURNING)
    old, new = result.in_force.apply(raw), result.correction.apply(raw)
    total = math.hypot(result.horizontal_mgauss, result.vertical_mgauss)
    if not math.isfinite(total):
        return ""
    # Any orientation keeps a reading as far from the middle as its length: no scale changes as it turns.
    reach = 1.05 * float(max(np.linalg.norm(np.vstack([old, new]), axis=1).max(), total))
    title = "The field in the vehicle's axes, before and after, and the Earth's sphere"
    spread = (-reach, reach)
    plot = Plot(spread, spread, "mG", title=title, height=400.0, equal=True, turns=True)

    def view(points: ArrayLike) -> FloatArray:
        """Look from behind, from above and a little from the right: (3, N) across, up, towards the viewer."""
        return _VIEW @ np.reshape(points, (-1, 3)).T

    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    around, still = np.stack([np.cos(turn), np.sin(turn)]), np.zeros(turn.size)
    level = result.horizontal_mgauss * around
    for ring in ((*around, still), (around[0], still, around[1]), (still, *around)):
        x, y, z = view(total * np.transpose(ring))
        plot.line(x, y, "truth", "the Earth's field", z)
    x, y, z = view(np.transpose([*level, still + result.vertical_mgauss]))
    plot.line(x, y, "iron", "the Earth's field when level", z)
    for points, css in ((old, "old"), (new, "new")):
        x, y, z = view(points)
        plot.dots(x, y, css, name=css, z=z)
    for words, (x, y, z) in zip(("forward", "right", "down"), view(total * np.eye(3)).T, strict=True):
        plot.text(x, y, words, dx=5.0, z=z)
    return plot.render()


def circle_figure(track: Track, result: CalibrationResult) -> str:
    """Draw the level field before and after: forward up, right to the right, with the Earth's circle."""
    old = circle_points(track, result, result.in_force)
    new = circle_points(track, result, result.correction)
    radius = result.horizontal_mgauss
    ring = [[-radius, radius]] if math.isfinite(radius) else []
    spread = limits(old, new, *ring, [0.0])
    title = "The field's level part as the vehicle turned, before and after"
    plot = Plot(spread, spread, "to the right, mG", "forward, mG", title, height=400.0, equal=True)
    if ring:
        plot.circle(radius, "truth", "the Earth's horizontal field")
    plot.dots(old[:, 1], old[:, 0], "old", name="old")
    plot.dots(new[:, 1], new[:, 0], "new", name="new")
    means = np.array([p.mean_mgauss for p in result.positions])
    if len(means):
        level = np.tile([0.0, 0.0, 1.0], (len(means), 1))
        stops = level_components(result.correction.apply(means), level)
        plot.dots(stops[:, 1], stops[:, 0], "stop", 4.0, "mean at a position")
        for k, (forward, right) in enumerate(stops):
            plot.text(right, forward, str(k + 1), dx=8.0, dy=4.0)
    return plot.render()


def raw_figure(track: Track, result: CalibrationResult) -> str:
    """Draw the raw field and the hard iron that was found in it."""
    raw = circle_points(track, result, FieldCorrection())
    ox, oy = (float(v) for v in result.raw_offset_mgauss[:2])
    spread_x, spread_y = limits(raw[:, 1], [0.0, oy]), limits(raw[:, 0], [0.0, ox])
    title = "The raw field as the vehicle turned, and the hard iron found"
    plot = Plot(spread_x, spread_y, "to the right, mG", "forward, mG", title, height=400.0, equal=True)
    plot.dots(raw[:, 1], raw[:, 0], "old", name="raw")
    plot.line([0.0, oy], [0.0, ox], "iron")
    plot.dots([oy], [ox], "stop", 4.5, "hard iron")
    plot.text(oy, ox, "hard iron", dx=9.0, dy=4.0)
    return plot.render()


def heading_error_figure(result: CalibrationResult) -> str:
    """Draw how far the old correction's heading is off, against the new one's sigma."""
    if (old := result.in_force_error_deg()) is None:
        return ""
    psi, old = np.arange(73) * 5.0, np.append(old, old[0])
    spread = limits(old, [-1.0, 1.0], sigma_deg(result, psi))
    plot = _over_the_circle(spread, "error, deg", "Heading error of the old calibration over the circle")
    sigma = sigma_deg(result, psi)
    plot.band(psi, -sigma, sigma, "new")
    plot.line(psi, old, "old", "old calibration")
    return plot.render()


def _over_the_circle(spread: tuple[float, float], label: str, title: str) -> Plot:
    return Plot(
        (0.0, 360.0), spread, "heading, deg", label, title, width=560.0, height=230.0, x_ticks=_COMPASS_TICKS
    )


def sigma_deg(result: CalibrationResult, heading_deg: ArrayLike) -> FloatArray:
    """Return the new calibration's heading sigma at headings (N,), degrees; its mean where that is all."""
    if result.heading_error is not None:
        return np.degrees(result.heading_error.sigma_rad(np.radians(heading_deg)))
    sigma = result.heading_sigma_deg if math.isfinite(result.heading_sigma_deg) else 0.0
    return np.full(np.shape(heading_deg), sigma)


def sigma_figure(result: CalibrationResult) -> str:
    """Draw the new sigma over the circle with what the positions leave over."""
    psi = np.arange(73) * 5.0
    sigma = sigma_deg(result, psi)
    where, left_over = position_residuals_deg(result)
    title = "Heading sigma of the new calibration, and residuals at the positions"
    plot = _over_the_circle(limits(sigma, -sigma, left_over, [0.0], least=0.5), "error, deg", title)
    plot.band(psi, -sigma, sigma, "new")
    plot.line(psi, sigma, "new", "one sigma")
    plot.line(psi, -sigma, "new", "one sigma")
    plot.dots(np.mod(where, 360.0), left_over, "stop", 4.0, "left over at a position")
    return plot.render()


def position_residuals_deg(result: CalibrationResult) -> tuple[FloatArray, FloatArray]:
    """Return the heading of each position and what its residual does to it, degrees."""
    if not result.positions:
        return np.zeros(0), np.zeros(0)
    means = np.array([p.mean_mgauss for p in result.positions])
    residuals = np.array([p.residual_mgauss for p in result.positions])
    seen = result.correction.apply(means)
    fitted = result.correction.apply(means - residuals)
    heading = np.degrees(level_heading(seen))
    off = np.degrees(level_heading(seen)) - np.degrees(level_heading(fitted))
    return heading, (off + 180.0) % 360.0 - 180.0


def residual_figure(result: CalibrationResult) -> str:
    """Draw each position's residual, axis by axis."""
    residuals = np.array([p.residual_mgauss for p in result.positions])
    if not len(residuals) or not np.isfinite(residuals).any():
        return ""
    count = len(residuals)
    plot = Plot(
        (0.5, count + 0.5),
        limits(residuals, [0.0], least=1.0),
        "position",
        "residual, mG",
        "What the fit leaves over at each position",
        x_ticks=range(1, count + 1),
    )
    for axis, name in enumerate("XYZ"):
        across = np.arange(1, count + 1) + 0.12 * (axis - 1)
        plot.dots(across, residuals[:, axis], f"axis-{name.lower()}", 4.0, name)
    return plot.render()


def budget_figure(result: CalibrationResult) -> str:
    """Draw where the heading's sigma comes from."""
    rows = [
        (_BUDGET_NAMES.get(name, name.replace("_", " ")), float(value))
        for name, value in result.heading_budget_deg.items()
    ]
    rows.sort(key=lambda row: -row[1])
    return bars(rows, "deg", "Heading error budget, one sigma")
