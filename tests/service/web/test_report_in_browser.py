"""A calibration's report in a browser: touched by mouse and keyboard, whole without scripts, alone."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from chromium import Page, find_chromium

from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.report.calibration import write_report
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.links.simulated import SimulatedLink


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    done = calibrate_on(
        SimulatedLink.of("rover", seed=3),
        "sim:rover",
        CalibrateSettings(writing="yes"),
        undo_directory=folder,
    )
    write_report(done, folder / "report.html")
    return (folder / "report.html").as_uri()


@pytest.fixture
def page() -> Iterator[Page]:
    if (program := find_chromium()) is None:
        pytest.skip("no Chromium here (Debian: apt install chromium)")
    page = Page(program, 390, 844)
    yield page
    page.close()


def plot(title: str) -> str:
    return f"svg.plot[aria-label*='{title}']"


def told(page: Page, title: str) -> str:
    return str(page.run(f'document.querySelector("{plot(title)} + .hand output").textContent'))


def shown(page: Page, what: str) -> list[str]:
    return list(
        page.run(f'[...document.querySelectorAll("{what}")].map(e => e.getAttribute("d") ?? e.textContent)')
    )


def test_values_are_told_and_plots_zoomed_by_mouse_and_keyboard(report: str, page: Page) -> None:
    page.open(report)
    title, card = "Heading error", dict(re.findall(r"(\d{3})°\t([-+]\d+\.\d)°", page.text("main")))
    page.run(f'document.querySelector("{plot(title)}").focus()')
    for _ in range(7):
        page.press("ArrowRight")
    assert told(page, title) == f"old calibration: heading 30 deg, error {float(card['030'])} deg"
    all_of_it = shown(page, f"{plot(title)} .tick")
    page.press("+")
    assert shown(page, f"{plot(title)} .tick") != all_of_it
    page.press("Escape")
    assert shown(page, f"{plot(title)} .tick") == all_of_it
    page.hover(plot("level part"))
    assert re.match(r"\w.*: to the right -?\d+ mG, forward -?\d+ mG$", told(page, "level part"))
    page.drag(plot("The raw field"), 60.0, 60.0)
    assert "zoomed" in page.run(f'document.querySelector("{plot("The raw field")}").className.baseVal')
    assert page.errors == [] and page.run("performance.getEntriesByType('resource').length") == 0
    for width, dark in ((1200, True), (390, False)):
        page.show_on(width, 844, dark)
        assert page.run("document.documentElement.scrollWidth <= window.innerWidth")


def test_the_sphere_turns_by_mouse_and_keyboard_and_keeps_every_length(report: str, page: Page) -> None:
    page.open(report)
    sphere = plot("Earth")
    seen = [shown(page, f"{sphere} .dots.new")]
    page.hover(sphere)
    length = re.search(r"\d+ mG long", told(page, "Earth"))
    page.drag(sphere, 50.0, 20.0)
    seen.append(shown(page, f"{sphere} .dots.new"))
    page.run(f'document.querySelector("{sphere}").focus()')
    page.press("ArrowLeft")
    seen.append(shown(page, f"{sphere} .dots.new"))
    assert len({str(one) for one in seen}) == 3 and page.errors == []
    assert length is not None and length[0] in told(page, "Earth")


def test_without_scripts_every_figure_is_there(report: str, page: Page) -> None:
    page.run_scripts(False)
    page.open(report)
    drawn = "[...document.querySelectorAll('figure > svg')].filter(s => s.querySelector('path, rect'))"
    assert page.run(f"{drawn}.length") == page.run("document.querySelectorAll('figure').length") > 6
    assert page.run("document.querySelectorAll('.hand').length") == 0
