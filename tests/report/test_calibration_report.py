"""The HTML report of a calibration."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mavcompass.errors import UsageError
from mavcompass.frames import euler_to_matrix, rotate_back
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.report.calibration import write_recording_report, write_report
from mavcompass.report.figures import level_components, position_residuals_deg, sigma_deg
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> CalibrationReport:
    link = SimulatedLink.of("rover", seed=3)
    settings = CalibrateSettings(instances=(1, 2), writing="yes")
    return calibrate_on(link, "sim:rover", settings, undo_directory=tmp_path_factory.mktemp("undo"))


@pytest.fixture
def html(report: CalibrationReport, tmp_path: Path) -> str:
    write_report(report, tmp_path / "report.html")
    return (tmp_path / "report.html").read_text(encoding="utf-8")


class _Balance(HTMLParser):
    """Hold that every element is closed in order."""

    _VOID = frozenset({"meta", "br", "path", "line", "circle", "rect", "text"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.count: dict[str, int] = {}

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_report_says_which_vehicle_and_firmware_it_is_about(html: str, report: CalibrationReport) -> None:
    assert report.vehicle is not None and report.vehicle.firmware and report.vehicle.firmware in html
    assert report.vehicle.uid in html and all(str(d) in html for d in report.vehicle.compasses)


def test_the_report_is_one_well_formed_file_that_needs_nothing_else(html: str) -> None:
    page = _Balance()
    page.feed(html)
    assert page.open == []
    assert page.count["figure"] == 14, "seven figures for each of two compasses"
    assert not re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?(?:https?:)?//', html)
    assert page.count["script"] == 1 and len(html) < 250_000


def test_the_report_says_what_was_found_and_done(html: str, report: CalibrationReport) -> None:
    assert "accepted" in html and "in force" in html
    assert report.proof is not None and report.proof.summary() in html
    for result in report.results:
        assert f"Compass {result.instance}" in html
        assert f"{result.heading_sigma_deg:.2f}°" in html
        for name in result.parameters:
            assert name in html
    for words in ("Before and after", "Deviation card", "Error budget", "Residuals"):
        assert html.count(words) == 2


def test_words_from_outside_cannot_become_markup(report: CalibrationReport, tmp_path: Path) -> None:
    from dataclasses import replace

    evil = replace(report, messages=("<script>alert(1)</script>",))
    write_report(evil, tmp_path / "evil.html")
    assert "<script>" not in (tmp_path / "evil.html").read_text()


def test_a_recording_gets_the_same_report(report: CalibrationReport, tmp_path: Path) -> None:
    write_recording_report(report.track, report.results, tmp_path / "recording.html")
    text = (tmp_path / "recording.html").read_text()
    assert "Recording" in text
    assert "in force" not in text


def test_a_place_that_cannot_be_written_is_told(report: CalibrationReport, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="could not be written"):
        write_report(report, tmp_path / "missing" / "report.html")


def test_level_components_see_through_tilt() -> None:
    roll, pitch, yaw = 0.3, -0.2, 1.1
    attitude = euler_to_matrix(roll, pitch, yaw)
    field = rotate_back(attitude, [200.0, 0.0, 400.0])[np.newaxis]
    down = rotate_back(attitude, [0.0, 0.0, 1.0])[np.newaxis]
    forward, right = level_components(field, down)[0]
    assert forward == pytest.approx(200.0 * np.cos(yaw))
    assert right == pytest.approx(-200.0 * np.sin(yaw))


def test_residuals_and_sigma_are_of_one_size_in_a_good_calibration(report: CalibrationReport) -> None:
    for result in report.results:
        _, residuals = position_residuals_deg(result)
        assert len(residuals) == 4
        assert np.abs(residuals).max() < 1.0
        assert 0.01 < sigma_deg(result, [0.0, 90.0, 180.0]).max() < 2.0
