"""The figures of a gap report: where the gap lies, how it closes, what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.answer.description import bin_means
from mavcompass.gap.result import Bar, Closing, Diagnosis, Picture
from mavcompass.report.svg import Plot, bars, limits

_MOST_POINTS = 1500
_AXES = "xyz"
# Name, rms, class of the style sheet, and where a bar that falls ends.
Level = tuple[str, float, str, float | None]
# Pixels: a letter, and the height of words with what is free above a bar.
_LETTER, _WORDS = 9.0, 14.0


def heading_tilt_map(picture: Picture, axis: int, after: bool) -> str:
    """Draw the mean residual of one axis over heading (across) and tilt (up); empty cells are hatched."""
    heading, tilt = picture.coordinates["heading"][0], picture.coordinates.get("tilt", (None, ""))[0]
    rows = picture.valid
    residual = (picture.after_mgauss if after else picture.before_mgauss)[rows, axis]
    across = np.clip((heading[rows] // 30.0).astype(int), 0, 11)
    top = float(np.max(tilt[rows])) if tilt is not None else 0.0
    height = 5 if top > 3.0 else 1
    up = np.zeros(across.size, dtype=int)
    if tilt is not None and height > 1:
        up = np.clip((tilt[rows] / (top + 1e-9) * height).astype(int), 0, height - 1)
    scale = max(float(np.abs(picture.before_mgauss[rows]).max()) * 0.7, 1e-9)
    cells = []
    for i in range(12):
        for j in range(height):
            chosen = residual[(across == i) & (up == j)]
            x, y = 34 + i * 22, 10 + (height - 1 - j) * 22
            if chosen.size < 3:
                cells.append(f'<rect x="{x}" y="{y}" width="21" height="21" class="empty"/>')
                continue
            mean = float(chosen.mean())
            strength = min(abs(mean) / scale, 1.0) ** 0.6
            css = "plus" if mean > 0 else "minus"
            title = f"{30 * i} to {30 * i + 30} deg: {mean:.1f} mG ({chosen.size} readings)"
            cells.append(
                f'<rect x="{x}" y="{y}" width="21" height="21" class="{css}"'
                f' fill-opacity="{0.06 + 0.94 * strength:.2f}"><title>{title}</title></rect>'
            )
    bottom = 10 + height * 22
    ticks = "".join(
        f'<text class="tick" x="{34 + k * 66}" y="{bottom + 13}">{90 * k}</text>' for k in range(5)
    )
    side = f'<text class="tick side" x="30" y="20">{top:.0f}°</text>' if height > 1 else ""
    name = escape(f"mean residual of {_AXES[axis]} over heading and tilt")
    return (
        f'<svg viewBox="0 0 312 {bottom + 30}" role="img" aria-label="{name}">{"".join(cells)}{ticks}{side}'
        f'<text class="label" x="166" y="{bottom + 27}">heading, deg</text></svg>'
    )


def strip(picture: Picture, coordinate: str) -> str:
    """Draw the mean residual along one coordinate, before (lines per axis) and after."""
    values, unit = picture.coordinates[coordinate]
    rows = picture.valid
    means = [bin_means(values[rows], picture.before_mgauss[rows, axis]) for axis in range(3)]
    left = [bin_means(values[rows], picture.after_mgauss[rows, axis]) for axis in range(3)]
    curves = [_drawn(m[1], m[2]) for m in (*means, *left)]
    plot = Plot(
        limits(values[rows]),
        limits(*curves, [0.0], least=4.0),
        f"{coordinate}{', ' + unit if unit else ''}",
        "mean residual, mG",
        f"mean residual along {coordinate}, before and after",
        height=220.0,
    )
    ends: list[float] = []
    for axis in range(3):
        plot.line(means[axis][0], curves[axis], "old", f"{_AXES[axis]} before")
        plot.line(left[axis][0], curves[3 + axis], "new", f"{_AXES[axis]} after")
        known = np.flatnonzero(np.isfinite(curves[axis]))
        if known.size:
            end = float(curves[axis][known[-1]])
            # Lines that end together have their letters side by side.
            beside = sum(abs(plot.y(end) - plot.y(other)) < _LETTER for other in ends)
            plot.text(means[axis][0][known[-1]], end, _AXES[axis], dx=3.0 + _LETTER * beside, dy=3.0)
            ends.append(end)
    return plot.render()


def _drawn(mean: FloatArray, count: FloatArray) -> FloatArray:
    return np.asarray(np.where(count >= 3, mean, np.nan))


def residual_overlay(picture: Picture, axis: int) -> str:
    """Draw one axis's residual over time, before and after, on held-out parts only."""
    rows = np.flatnonzero(picture.test)
    rows = rows[:: max(1, rows.size // _MOST_POINTS)]
    before, after = picture.before_mgauss[rows, axis], picture.after_mgauss[rows, axis]
    plot = Plot(
        limits(picture.time_s),
        limits(before, after, least=4.0),
        "time, s",
        f"{_AXES[axis]}, mG",
        f"residual of {_AXES[axis]} on held-out parts, before and after",
        width=880.0,
        height=180.0,
    )
    plot.dots(picture.time_s[rows], before, "old", 1.4, "before")
    plot.dots(picture.time_s[rows], after, "new", 1.4, "after")
    return plot.render()


def waterfall_figure(closing: Closing, steps: Sequence[Bar]) -> str:
    """Draw the gap as bars from nominal over each effect to after, and the floor as a line."""
    levels: list[Level] = [("nominal", closing.nominal, "old", None)]
    rms = closing.nominal
    for step in steps:
        before, rms = rms, math.sqrt(max(rms**2 - step.part_mgauss2, 0.0))
        levels.append((step.effect, before, "step", rms))
    return levels_figure([*levels, ("after", closing.after, "new", None)], closing.floor, "mG", 640.0)


def levels_figure(levels: Sequence[Level], floor: float, unit: str, least: float = 0.0) -> str:
    """Draw named levels as bars on one scale, and the floor as a line; at least so many pixels wide.

    A bar that does not stand on the ground falls from its level to another, which is told.
    """
    top = max([max(level, end or 0.0) for _, level, _, end in levels] + [floor, 1e-9]) * 1.12
    width, base = 128.0, 170.0
    at = base - floor / top * (base - 14.0)
    start = max(60.0, (least - width * len(levels)) / 2.0)
    pieces = []
    for k, (name, level, css, end) in enumerate(levels):
        x, y = start + k * width, base - max(level, end or 0.0) / top * (base - 14.0)
        high = max(abs(level - (end or 0.0)) / top * (base - 14.0), 1.0)
        # Where the line of the floor does not go through the words.
        above = (at if 0.0 < y - at < _WORDS else y) - 4.0
        words = f"{level:.2f} {unit}" if end is None else f"to {end:.2f} {unit}"
        pieces.append(
            f'<rect class="fall {css}" x="{x}" y="{y:.1f}" width="76" height="{high:.1f}" rx="3"/>'
            f'<text class="mark mid" x="{x + 38}" y="{above:.1f}">{escape(words)}</text>'
            f'<text class="tick" x="{x + 38}" y="{base + 14}">{escape(name)}</text>'
        )
    end_x = start - 20.0 + width * len(levels)
    return (
        f'<svg viewBox="0 0 {max(end_x + 10.0, least):.0f} 196" role="img" aria-label="the gap, {unit}">'
        f'{"".join(pieces)}<line class="floor" x1="{start - 8.0}" x2="{end_x}" y1="{at:.1f}" y2="{at:.1f}"/>'
        f'<text class="tick side" x="{start - 12.0}" y="{at:.1f}" dy="0.32em">floor</text></svg>'
    )


def spectrum_figure(picture: Picture) -> str:
    """Draw the spectrum of what is left, in units of the floor's (1: white noise at the floor)."""
    step = float(np.median(np.diff(picture.time_s)))
    z = np.where(picture.valid[:, None], picture.innovations, 0.0)
    power = (np.abs(np.fft.rfft(z, axis=0)) ** 2 / len(z)).mean(axis=1)
    frequency = np.fft.rfftfreq(len(z), step)
    bins = max(1, power.size // 200)
    cut = power.size // bins * bins
    smooth = power[:cut].reshape(-1, bins).mean(axis=1)
    centre = frequency[:cut].reshape(-1, bins).mean(axis=1)
    plot = Plot(
        limits(centre), limits(smooth, [0.0, 2.0]), "frequency, Hz", "power, floors",
        "spectrum of what is left", height=220.0,
    )  # fmt: skip
    plot.line(centre, np.ones_like(centre), "truth")
    plot.line(centre, smooth, "new", "what is left")
    return plot.render()


def tests_figure(tests: Sequence[tuple[str, float]]) -> str:
    """Draw the smallest p-values as bars of -log10 p."""
    rows = [(name, min(-math.log10(max(p, 1e-30)), 30.0)) for name, p in tests[:10]]
    return bars(rows, "", "tests of what is left")


def ambiguity_figure(diagnosis: Diagnosis) -> str:
    """Draw the explanations as bars of their probability, where there are several."""
    sets = diagnosis.ambiguity_set[:6]
    rows = [(" + ".join(names), 100.0 * weight) for names, weight in sets if len(sets) > 1]
    return bars(rows, "%", "explanations and their probabilities")


def interval_figure(low: float, share: float, high: float) -> str:
    """Draw a share with its interval on a line from 0 to 100 %."""
    a, m, b = (4.0 + 152.0 * v for v in (low, share, high))
    return (
        '<svg class="interval" viewBox="0 0 160 14" role="img" aria-label="share and interval">'
        '<line class="scale" x1="4" x2="156" y1="7" y2="7"/>'
        f'<line class="range" x1="{a:.1f}" x2="{b:.1f}" y1="7" y2="7"/>'
        f'<circle class="disc" cx="{m:.1f}" cy="7" r="3.4"/></svg>'
    )


def gap_figures(diagnosis: Diagnosis) -> Mapping[str, object]:
    """Draw all the figures that the report needs."""
    picture = diagnosis.picture
    if picture is None:
        return {"maps": [], "strips": [], "overlays": [], "spectrum": ""}
    order = ["time", "current", "throttle", "temperature", "position", "rate"]
    return {
        "maps": [
            (axis, heading_tilt_map(picture, i, False), heading_tilt_map(picture, i, True))
            for i, axis in enumerate(_AXES)
        ],
        "strips": [(name, strip(picture, name)) for name in order if name in picture.coordinates],
        "overlays": [(axis, residual_overlay(picture, i)) for i, axis in enumerate(_AXES)],
        "spectrum": spectrum_figure(picture),
    }
