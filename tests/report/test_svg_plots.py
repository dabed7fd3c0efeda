"""The small plots of the reports."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.gap.result import Closing, Picture
from mavcompass.report.gap_figures import levels_figure, strip, waterfall_figure
from mavcompass.report.svg import Plot, bars, limits, nice_ticks


@given(st.floats(-1e5, 1e5), st.floats(1e-3, 1e6))
def test_ticks_are_round_inside_and_a_handful(low: float, span: float) -> None:
    ticks = nice_ticks(low, low + span)
    assert 2 <= len(ticks) <= 12
    assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) + 1e-9 for tick in ticks)
    steps = np.diff(ticks)
    assert np.allclose(steps, steps[0], rtol=1e-5)


def test_ticks_of_an_empty_axis() -> None:
    assert nice_ticks(3.0, 3.0) == [3.0]
    assert nice_ticks(math.nan, 1.0) == []


def test_limits_hold_what_is_finite() -> None:
    low, high = limits([1.0, math.nan], [[5.0, math.inf]])
    assert low < 1.0 and 5.0 < high < 6.0
    assert limits([math.nan]) == (0.0, 1.0)
    low, high = limits([2.0], least=1.0)
    assert high - low >= 1.0


def test_a_plot_is_well_formed_and_places_points_right() -> None:
    plot = Plot((0.0, 10.0), (0.0, 1.0), "heading & more", "error < 1", 'title "quoted"')
    plot.line([0.0, 5.0, math.nan, 10.0], [0.0, 0.5, 0.5, 1.0], "old")
    plot.band([0.0, 10.0], [0.1, 0.1], [0.2, 0.2], "new")
    plot.dots([5.0, math.nan], [0.5, 0.5], "stop")
    plot.text(1.0, 1.0, "<1>")
    root = ET.fromstring(plot.render())
    assert root.attrib["aria-label"] == 'title "quoted"'
    path = next(e for e in root.iter() if e.attrib.get("class") == "line old")
    assert path.attrib["d"].count("M") == 2, "a gap breaks the line"
    assert plot.x(5.0) == pytest.approx((plot.x(0.0) + plot.x(10.0)) / 2)
    assert plot.y(1.0) < plot.y(0.0)


def test_equal_units_make_a_circle_round() -> None:
    plot = Plot((-1.0, 1.0), (-3.0, 3.0), equal=True)
    assert plot.x(1.0) - plot.x(0.0) == pytest.approx(plot.y(0.0) - plot.y(1.0))
    assert plot.y_range[0] <= -3.0 and plot.x_range[0] <= -1.0


def test_bars_are_as_long_as_their_values() -> None:
    root = ET.fromstring(
        bars([("tilt", 0.4), ("noise", 0.1), ("none", math.nan), ("tiny", 1e-6)], "deg", "t")
    )
    widths = [float(e.attrib["width"]) for e in root if e.tag == "rect"]
    assert len(widths) == 3
    assert widths[0] == pytest.approx(4 * widths[1], rel=0.01)
    assert "< 0.001 deg" in "".join(root.itertext())
    assert bars([("none", math.nan)], "deg", "t") == ""


# --- The figures of a gap report: words that can be read


def waterfall(after: float, floor: float) -> str:
    return waterfall_figure(Closing(48.0, after, floor, 1.0, (1.0, 1.0)), ())


def levels(after: float, floor: float) -> str:
    return levels_figure([("nominal", 48.0, "old", None), ("after", after, "new", None)], floor, "mG")


@pytest.mark.parametrize("figure", [waterfall, levels])
@pytest.mark.parametrize(
    ("after", "floor"), [(0.4, 1.4), (0.2, 2.8), (1.4, 1.4), (3.0, 1.0), (0.2, 12.0), (44.0, 47.0)]
)
def test_the_line_of_the_floor_does_not_go_through_words(
    figure: Callable[[float, float], str], after: float, floor: float
) -> None:
    root = ET.fromstring(figure(after, floor))
    line = next(float(e.attrib["y1"]) for e in root if e.attrib.get("class") == "floor")
    words = [float(e.attrib["y"]) for e in root if e.attrib.get("class") == "mark mid"]
    assert len(words) == 2
    assert not any(baseline - 9.0 < line < baseline + 1.0 for baseline in words)


def test_lines_that_end_together_have_their_letters_side_by_side() -> None:
    time = np.linspace(0.0, 100.0, 400)
    before = np.tile([-50.0, 40.0, 40.5], (time.size, 1))
    every = np.ones(time.size, dtype=np.bool_)
    picture = Picture(
        time_s=time, before_mgauss=before, after_mgauss=0.0 * before,
        valid=every, test=every, innovations=0.0 * before, coordinates={"time": (time, "s")},
    )  # fmt: skip
    root = ET.fromstring(strip(picture, "time"))
    at = {e.text: float(e.attrib["dx"]) for e in root.iter() if e.attrib.get("class") == "mark"}
    assert at["y"] == at["x"] and at["z"] >= at["y"] + 8.0
