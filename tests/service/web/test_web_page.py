"""The page in a real browser: a calibration from the first look to written parameters.

Pictures of every step are saved in the folder $MAVCOMPASS_SCREENSHOTS, by default build/screenshots.
"""

from __future__ import annotations

import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from chromium import Page, find_chromium
from running_service import RunningService, StartService, wait_for

from mavcompass.service.config import HttpConfig
from mavcompass.simulation.heading_error import heading_error_rms_deg, heading_errors_rad
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink

SCREENSHOTS = Path(
    os.environ.get("MAVCOMPASS_SCREENSHOTS") or Path(__file__).parents[3] / "build" / "screenshots"
)
PHONE, DESK = (390, 844), (1200, 900)

OpenPage = Callable[..., Page]


@pytest.fixture
def start_site() -> Iterator[Callable[[dict[str, str]], str]]:
    """Serve pages of somebody else on another port; return their origin."""
    with ExitStack() as stack:

        def start(pages: dict[str, str]) -> str:
            class Answer(BaseHTTPRequestHandler):
                def do_GET(self) -> None:
                    self.send_response(200)
                    self.send_header("content-type", "text/html")
                    self.end_headers()
                    self.wfile.write(pages.get(self.path, "").encode())

                def log_message(self, *_: object) -> None:
                    pass

            server = stack.enter_context(ThreadingHTTPServer(("127.0.0.1", 0), Answer))
            stack.callback(server.shutdown)
            threading.Thread(target=server.serve_forever, daemon=True).start()
            return f"http://127.0.0.1:{server.server_port}"

        yield start


@pytest.fixture
def open_page() -> Iterator[OpenPage]:
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium here (Debian: apt install chromium)")
    pages: list[Page] = []

    def open_it(running: RunningService, token: bool = True) -> Page:
        page = Page(program, *PHONE)
        pages.append(page)
        page.open(running.service.url + (f"#token={running.service.token}" if token else ""))
        page.wait("document.querySelector('#heading').innerText !== '–'")
        return page

    yield open_it
    for page in pages:
        page.close()


def look(page: Page, step: str, whole: bool = False) -> None:
    """Take pictures of a dark desk's screen and of a phone's; nothing sticks out sideways."""
    for size, dark in ((DESK, True), (PHONE, False)):
        page.show_on(*size, dark=dark)
        assert page.run("document.documentElement.scrollWidth <= window.innerWidth")
        page.screenshot(SCREENSHOTS / f"{size[0]}x{size[1]}-{step}.png", whole)


def lit(page: Page) -> int:
    return int(page.run("document.querySelectorAll('.c-spot.lit').length"))


def test_a_calibration_from_the_page_to_written_parameters(
    start_service: StartService, open_page: OpenPage
) -> None:
    running = start_service(speed=8.0)
    assert running.link is not None
    page = open_page(running)
    assert page.run("location.hash") == "", "the token stays out of the address bar"
    assert page.run("document.querySelector('#token-box').hidden")
    look(page, "1-heading")

    page.click("#calibrate")
    page.wait("document.activeElement === document.querySelector('#stop')")
    page.wait("document.querySelectorAll('.c-spot.lit').length >= 2")
    look(page, "2-turning")
    page.wait("!document.querySelector('#question').hidden")
    # Four, and further ones where four left doubt: whatever was visited is lit.
    assert lit(page) == page.run("document.querySelectorAll('.c-spot').length") >= 4
    page.wait("document.querySelector('#prompt').innerText.startsWith('Write the new calibration')")
    told = page.text("#proposals")
    assert re.findall(r"Compass (\d)", told) == ["1", "2", "3"]
    assert re.search(r"Compass 1\s+\d\d\.\d° → 0\.\d\d° off", told), told
    assert page.run("document.querySelectorAll('#proposals svg').length") >= 1
    assert page.text("#yes") == "Write" and not page.run("document.querySelector('#details').open")
    for shown in ("prompt", "proposals", "yes"):  # all of it on one screen
        box = f"document.querySelector('#{shown}').getBoundingClientRect()"
        assert page.run(f"{box}.top >= 0 && {box}.bottom <= innerHeight"), shown
    look(page, "3-question")
    late = open_page(running, token=False)  # a second device joins now
    late.wait("!document.querySelector('#question').hidden")
    late.wait("document.querySelectorAll('.c-spot.lit').length >= 4")
    for what in ("#proposals", "#prompt", "#turned"):
        inner = f"document.querySelector('{what}').textContent"
        assert late.run(inner) == page.run(inner), what
    trail = "document.querySelector('.c-trail').getAttribute('d')"
    # It sways, and each hears of the next point when it does.
    assert any(late.run(trail) == page.run(trail) or time.sleep(0.05) for _ in range(200))
    page.click("#details summary")
    assert "COMPASS_OFS_X" in page.text("#details")
    before_deg = heading_error_rms_deg(running.link.autopilot)  # type: ignore[arg-type]

    page.click("#yes")
    page.wait("!document.querySelector('#result').hidden")
    assert "written, read back" in page.text("#result .verdict")
    assert heading_error_rms_deg(running.link.autopilot) < 0.1 * before_deg  # type: ignore[arg-type]
    page.wait("document.querySelectorAll('#history li[data-kind=calibration]').length === 1")
    for part in ("Old and new", "Error budget", "Deviation card"):
        assert part in page.text("#result")
    page.hover("#result svg.plot")
    assert re.match(r"old calibration: heading \d+ deg, error -?\d+\.\d deg", page.text("#result output"))
    look(page, "4-result", whole=True)
    assert page.errors == []

    page.open(f"{running.service.url}api/history/1/report")
    assert "Compass calibration" in page.text("h1")
    assert page.run("document.querySelectorAll('.hand').length") > 6, "the policy lets its script run"
    look(page, "5-report", whole=True)
    assert page.errors == []


def test_what_drives_sees_its_course_beside_the_heading_and_its_field_beside_the_earths(
    start_service: StartService, open_page: OpenPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = SimulatedLink.of("rover", seed=3, speed=4.0)
    page, vehicle = open_page(start_service(link)), link.autopilot
    assert isinstance(vehicle, SimulatedAutopilot)
    assert page.run("document.querySelector('#moving').hidden"), "a course that nobody has is not shown"
    monkeypatch.setattr(
        type(vehicle.firmware.steering), "control", lambda *_: Drive(0.0, 3.0, motors_on=True)
    )
    page.wait("!document.querySelector('#moving').hidden")
    truly_deg = math.degrees(vehicle.truth.yaw_rad) % 360.0
    assert float(page.text("#course").rstrip("°")) == pytest.approx(truly_deg, abs=5.0)
    assert page.run("document.querySelector('.r-course').getAttribute('visibility')") == "visible"
    # From above and from the side: the vector now, where it was, and the Earth's.
    for drawn in (".f-vector", ".f-trail", "#field .c-earth"):
        assert page.run(f"document.querySelectorAll('{drawn}').length") == 2
    look(page, "driving")
    assert page.errors == []


def test_what_was_put_aboard_is_told_with_the_quarter_turn_that_puts_it_right(
    start_service: StartService, open_page: OpenPage
) -> None:
    step = "hard_iron_step:x=30,y=20,z=0,on_s=60"
    link = SimulatedLink.of("rover", seed=6, effects=(step,), by_hand=True, speed=8.0)
    page = open_page(start_service(link))
    page.wait(
        "[...document.querySelectorAll('#findings b')].some(e => /while the vehicle stood/.test(e.innerText))"
    )
    look(page, "put-aboard")
    page.run("document.querySelector('#findings button').click()")  # which is drawn anew all the time
    page.wait("/Position 1 of 2/.test(document.querySelector('main').innerText)")
    page.click("#stop")
    page.wait("/Nothing written/.test(document.querySelector('main').innerText)")
    assert page.errors == []


def test_a_person_is_told_how_to_turn_and_can_stop(start_service: StartService, open_page: OpenPage) -> None:
    link = SimulatedLink.of("rover", seed=5, speed=4.0)
    link.autopilot.disarm()  # type: ignore[attr-defined]
    page = open_page(start_service(link))
    page.wait("document.querySelector('#motion-hint').innerText.includes('by hand')")
    page.click("#calibrate")
    page.wait("document.querySelector('#prompt').innerText.startsWith('Turn right')")
    page.screenshot(SCREENSHOTS / "390x844-6-by-hand.png")
    page.click("#stop")
    page.wait("!document.querySelector('#result').hidden")
    assert "Stopped from the page" in page.text("#result")
    assert page.errors == []


def test_a_vehicle_that_nobody_can_turn_is_calibrated_by_the_heading_that_is_typed_in(
    start_service: StartService, open_page: OpenPage
) -> None:
    link = SimulatedLink.of("rover", seed=5, speed=8.0)
    vehicle = link.autopilot
    assert isinstance(vehicle, SimulatedAutopilot)
    vehicle.disarm()
    stands_at = vehicle.truth.yaw_rad
    running = start_service(link)
    page = open_page(running)

    def choose(what: str, value: str) -> None:
        page.run(f"document.querySelector('#{what}').value = '{value}'")
        page.run(f"document.querySelector('#{what}').dispatchEvent(new Event('change'))")

    page.run("document.querySelector('#work details').open = true")
    assert page.run("document.querySelector('#true-heading').offsetParent === null")
    choose("method", "one-point")
    assert "left where it stands" in page.text("#motion-hint")
    choose("true-heading", "400")
    page.click("#calibrate")
    assert page.run("document.querySelector('#running').hidden"), "no such heading: nothing was sent"
    choose("true-heading", f"{math.degrees(stands_at):.2f}")
    choose("max-error", "8")  # one position tells no more than about five degrees of the whole circle
    look(page, "9-true-heading")
    page.click("#calibrate")
    page.wait("!document.querySelector('#question').hidden")
    page.wait("document.querySelectorAll('.c-spot.lit').length === 1")
    assert page.run("document.querySelectorAll('.c-spot').length") == 1
    page.click("#yes")
    page.wait("!document.querySelector('#result').hidden")
    assert "written, read back" in page.text("#result .verdict")

    # Two compasses were right already: nothing was written for them, and nobody has changed them since.
    def judged() -> dict[str, Any] | None:
        state = running.client.get("/api/state").json()
        return state if all(c["calibration_sigma_deg"] for c in state["vehicle"]["compasses"]) else None

    assert "parameters" not in [finding["id"] for finding in wait_for(judged)["findings"]]
    assert vehicle.truth.yaw_rad == pytest.approx(stands_at, abs=1e-9)
    errors = heading_errors_rad(vehicle)
    here = round((stands_at + math.pi) / math.tau * len(errors)) % len(errors)
    assert abs(math.degrees(errors[here])) < 1.0
    assert page.errors == []


def test_a_disarmed_vehicle_is_armed_after_a_person_has_agreed_to_that_by_the_keyboard_alone(
    start_service: StartService, open_page: OpenPage, disarmed: SimulatedLink
) -> None:
    """Its compass keeps it from arming: to set that check aside is a question of its own."""
    page, firmware = open_page(start_service(disarmed)), disarmed.autopilot.firmware  # type: ignore[attr-defined]
    before = dict(firmware.store.values)
    page.wait("document.querySelector('#motion-hint').innerText.includes('by hand')")
    page.run("document.querySelector('#work details').open = true")
    page.run("document.querySelector('#motion').value = 'vehicle'")
    page.run("document.querySelector('#motion').dispatchEvent(new Event('change'))")
    assert "asked whether it may be armed" in page.text("#motion-hint")

    def changed() -> set[str]:
        return {name.split("_")[0] for name, value in firmware.store.values.items() if before[name] != value}

    def press(what: str) -> None:
        page.tab_to(what)
        page.press("Enter")

    press("#calibrate")
    page.wait("document.querySelector('#consent').open")
    look(page, "8-may-it-be-armed")
    press("#decline")
    assert page.run("document.querySelector('#running').hidden"), "nothing was sent"
    for answer in ("#no", "#yes"):
        press("#calibrate")
        press("#agree")
        page.wait("document.activeElement === document.querySelector('#question')")
        assert "arming check aside" in page.text("#prompt") and changed() <= {"STAT"}
        look(page, "9-compass-check")
        press(answer)
        if answer == "#no":
            page.wait("document.querySelector('#result').innerText.includes('refused to arm')")
    page.wait("document.querySelector('#prompt').innerText.startsWith('Write the new calibration')")
    assert firmware.status.armed and firmware.store.values["ARMING_CHECK"] == before["ARMING_CHECK"]
    page.tab_to("#yes", most=4)
    page.press("Enter")
    page.wait("document.querySelector('#result .verdict')?.innerText.includes('written, read back')")
    assert not firmware.status.armed
    assert changed() == {"COMPASS", "STAT"}
    assert page.errors == []


@pytest.mark.parametrize("named", [True, False])
def test_in_blueos_the_page_stands_in_a_frame_and_has_the_token(
    start_service: StartService, open_page: OpenPage, start_site: Callable[[dict[str, str]], str], named: bool
) -> None:
    site: dict[str, str] = {}
    other = start_site(site)
    origins = (other,) if named else ()
    running = start_service(http=HttpConfig(listen="127.0.0.1:0", framed_by=origins))
    enter = running.stranger.get("/register_service").json().get("route", "/extension/mavcompass/")
    inner = running.service.url + enter.removeprefix("/extension/mavcompass/")
    site["/"] = f"<iframe src='{inner}?time=1' style='width:100%;height:95vh;border:0'></iframe>"
    page = open_page(running, token=False)
    page.open(other)
    if not named:
        wait_for(lambda: "refused" in str(page.run_in_frame("document.body.innerText")))
        return
    degrees = "document.querySelector('#heading').innerText"
    wait_for(lambda: str(page.run_in_frame(degrees)).isdecimal())
    assert page.run_in_frame("location.pathname + location.search + location.hash") == "/"
    page.screenshot(SCREENSHOTS / "390x844-10-framed.png")
    page.run_in_frame("document.querySelector('#calibrate').click()")
    wait_for(lambda: running.service.station.desk.busy)
    assert page.run_in_frame("document.querySelector('#refusal').hidden")


def test_without_the_token_the_page_only_shows(running: RunningService, open_page: OpenPage) -> None:
    page = open_page(running, token=False)
    assert not page.run("document.querySelector('#token-box').hidden")
    page.click("#calibrate")
    page.wait("!document.querySelector('#refusal').hidden")
    assert "needs the token" in page.text("#refusal")
    assert running.service.station.desk.current is None
    page.run(f"document.querySelector('#token').value = {running.service.token!r}")
    page.click("#token-form button")
    page.click("#check")
    page.wait("!document.querySelector('#result').hidden")
    assert "Not fit" in page.text("#result .verdict")
    page.screenshot(SCREENSHOTS / "390x844-7-check.png", whole=True)


def test_the_page_says_when_service_or_vehicle_are_away(running: RunningService, open_page: OpenPage) -> None:
    page = open_page(running)
    page.wait("document.querySelector('#status').className.includes('on')")
    running.service.stop()
    page.wait("document.querySelector('#status').innerText.includes('not reached')")
    wait_for(lambda: not running._thread.is_alive())
