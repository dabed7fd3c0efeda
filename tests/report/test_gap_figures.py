"""The figures of a gap report: words that can be read."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pytest

from mavcompass.gap.result import Closing, Picture
from mavcompass.report.gap_figures import levels_figure, strip, waterfall_figure


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
