"""What ground stations hear from component 191, and what it does when they command."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MagCalStatus, MavCmd, MavResult, MavSeverity
from mavcompass.errors import MavCompassError
from mavcompass.heading.live import Heading, LiveCompass
from mavcompass.messages import Incoming
from mavcompass.procedure.script import Show
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.service.config import MavlinkConfig, ServiceConfig
from mavcompass.service.mavlink import component
from mavcompass.service.mavlink.component import GroundStationReporter
from mavcompass.service.view import VehicleView
from mavcompass.service.watch import Finding
from mavcompass.service.work.clock import Schedule
from mavcompass.service.work.tasks import CalibrationRequest, CheckRequest, Desk, Task, UndoRequest
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.wire import decode, encode

CORRECTION = FieldCorrection((10.5, -20.25, 30.0), (1.1, 0.9, 1.0), (0.01, 0.02, 0.03), 1.05)


def result(instance: int = 1, accepted: bool = True) -> CalibrationResult:
    reasons = () if accepted else ("The field is far too strong here.",)
    found = CalibrationResult(instance, "four-positions", accepted, reasons, CORRECTION)
    return replace(found, residual_rms_mgauss=1.5, heading_sigma_deg=0.7)


def task(state: str = "running", **changes: Any) -> Task:
    made = Task(1, CalibrationRequest(), "http", "2026-05-01T00:00:00+00:00")
    made.state = state  # type: ignore[assignment]
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def command(number: int, *params: float) -> mav.CommandLong:
    return mav.CommandLong(1, 191, number, 0, *params)


@pytest.mark.parametrize(("mask", "chosen"), [(0.0, (1, 2, 3)), (1.0, (1,)), (6.0, (2, 3)), (7.0, (1, 2, 3))])
def test_a_calibration_starts_for_the_compasses_of_the_mask(mask: float, chosen: tuple[int, ...]) -> None:
    reply = component.answer(command(MavCmd.DO_START_MAG_CAL, mask), None, (1, 2, 3), True)
    assert reply == (MavResult.ACCEPTED, CalibrationRequest(compasses=chosen, writing="ask"))


def test_accepting_an_offer_is_consent_to_have_it_written() -> None:
    reply = component.answer(command(MavCmd.DO_ACCEPT_MAG_CAL), None, (1, 2), True, offered=(2,))
    assert reply == (MavResult.ACCEPTED, CalibrationRequest((2,), writing="yes", method="running"))
    assert component.answer(command(MavCmd.DO_ACCEPT_MAG_CAL), None, (1, 2), True) == (MavResult.FAILED, None)


def test_autosave_writes_without_asking() -> None:
    reply = component.answer(command(MavCmd.DO_START_MAG_CAL, 0, 1, 1), None, (1,), True)
    assert reply == (MavResult.ACCEPTED, CalibrationRequest((1,), writing="yes"))


@pytest.mark.parametrize(
    ("params", "under_way", "allowed", "expected"),
    [
        ((0.0,), "running", True, MavResult.TEMPORARILY_REJECTED),
        ((0.0,), None, False, MavResult.DENIED),
        ((8.0,), None, True, MavResult.FAILED),
        ((2.0,), None, True, MavResult.FAILED),
        ((math.nan,), None, True, MavResult.DENIED),
        ((-1.0,), None, True, MavResult.DENIED),
        ((255.0,), None, True, MavResult.FAILED),
        ((256.0,), None, True, MavResult.DENIED),
        ((1.0, math.nan), None, True, MavResult.DENIED),
        ((1.0, 0.0, math.inf), None, True, MavResult.DENIED),
        ((1.0, 0.0, 0.0, math.nan), None, True, MavResult.DENIED),
        ((1e30,), None, True, MavResult.DENIED),
    ],
)
def test_a_start_is_refused(
    params: tuple[float, ...], under_way: str | None, allowed: bool, expected: MavResult
) -> None:
    current = None if under_way is None else task(under_way)
    reply = component.answer(command(MavCmd.DO_START_MAG_CAL, *params), current, (1,), allowed)
    assert reply == (expected, None)


def test_accept_and_cancel_do_what_they_say_when_there_is_something() -> None:
    before_a_result = task("asking", question="May the compass's arming check be set aside?")
    asking = task("asking", question="Write?", results=(result(),))
    accept, cancel = (command(number) for number in (MavCmd.DO_ACCEPT_MAG_CAL, MavCmd.DO_CANCEL_MAG_CAL))
    assert component.answer(accept, before_a_result, (1,), True) == (MavResult.FAILED, None)
    assert component.answer(accept, asking, (1,), True) == (MavResult.ACCEPTED, "accept")
    assert component.answer(accept, task(), (1,), True) == (MavResult.FAILED, None)
    assert component.answer(cancel, task(), (1,), True) == (MavResult.ACCEPTED, "cancel")
    assert component.answer(cancel, None, (1,), True) == (MavResult.ACCEPTED, None)


def test_other_commands_are_not_supported() -> None:
    reply = component.answer(command(MavCmd.COMPONENT_ARM_DISARM, 1), None, (1,), True)
    assert reply == (MavResult.UNSUPPORTED, None)


def test_a_command_int_means_the_same() -> None:
    long = component.as_long(mav.CommandInt(1, 191, 0, MavCmd.DO_START_MAG_CAL, param1=2.0, param3=1.0))
    assert long == command(MavCmd.DO_START_MAG_CAL, 2.0, 0.0, 1.0)
    assert component.as_long(mav.Heartbeat()) is None


def test_progress_never_falls_and_is_complete_when_there_is_a_solution() -> None:
    running = task()
    seen = []
    for fraction in (0.0, 0.3, 0.2, 0.8, 1.0):
        running.show(Show("turn", "x", fraction))
        message = component.progress(running, (1, 2))[1]
        assert isinstance(message, mav.MagCalProgress)
        assert (message.compass_id, message.cal_mask, message.attempt) == (1, 3, 1)
        seen.append(message.completion_pct)
        assert sum(bin(byte).count("1") for byte in message.completion_mask) == round(0.8 * seen[-1])
    assert seen == [0, 30, 30, 80, 99]
    running.results = (result(),)
    done = component.progress(running, (1,))[0]
    assert isinstance(done, mav.MagCalProgress)
    assert done.completion_pct == 100
    assert set(done.completion_mask) == {255}


def test_a_report_carries_the_correction_in_the_order_of_the_parameters() -> None:
    finished = task("done", results=(result(),), ok=True, document={"written": True})
    report = component.reports(finished, (1,))[0]
    assert isinstance(report, mav.MagCalReport)
    assert report.cal_status == MagCalStatus.SUCCESS
    assert report.autosaved == 1
    assert (report.ofs_x, report.ofs_y, report.ofs_z) == CORRECTION.offsets_mgauss
    assert (report.diag_x, report.diag_y, report.diag_z) == CORRECTION.diagonals
    assert (report.offdiag_x, report.offdiag_y, report.offdiag_z) == CORRECTION.off_diagonals
    assert report.scale_factor == CORRECTION.scale
    assert report.fitness == 1.5
    (unknown,) = component.reports(task(results=(replace(result(), residual_rms_mgauss=math.nan),)), (1,))
    assert isinstance(unknown, mav.MagCalReport) and unknown.fitness == 0.0
    form, payload = encode(report)
    assert decode(form.id, payload) is not None


@pytest.mark.parametrize(
    ("made", "status", "saved"),
    [
        (task("asking", results=(result(),), question="Write?"), MagCalStatus.SUCCESS, 0),
        (task("done", results=(result(),), ok=True, document={"written": False}), MagCalStatus.SUCCESS, 0),
        (task("done", results=(result(accepted=False),), document={}), MagCalStatus.FAILED, 0),
        (task("failed", error="lost"), MagCalStatus.FAILED, 0),
        (task("failed", results=(result(),), error="could not be written"), MagCalStatus.FAILED, 0),
    ],
)
def test_a_report_says_how_it_ended(made: Task, status: MagCalStatus, saved: int) -> None:
    report = component.reports(made, (1,))[0]
    assert isinstance(report, mav.MagCalReport)
    assert (report.cal_status, report.autosaved) == (status, saved)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            task("done", results=(result(),), document={"written": True}),
            "Compass 1 calibrated, heading +-0.7 deg",
        ),
        (task("done", results=(result(),), document={"written": False}), "Compass 1: solved, not written"),
        (
            task("done", results=(result(accepted=False),), document={}),
            "Compass 1 not calibrated: The field is",
        ),
        (task("failed", error="The vehicle was disarmed."), "calibration failed: The vehicle was disarmed."),
        (task("failed", error="word " * 60), "calibration failed: word"),
    ],
)
def test_the_pilot_is_told_the_outcome_in_fifty_letters_a_line(made: Task, words: str) -> None:
    texts = component.outcome_texts(made)
    assert 1 <= len(texts) <= 3
    assert all(isinstance(text, mav.Statustext) and len(text.text) <= 50 for text in texts)
    first = texts[0]
    assert isinstance(first, mav.Statustext) and first.text.startswith(words)


@pytest.mark.parametrize(
    ("document", "severity", "told"),
    [
        ({"verdict": "pass"}, MavSeverity.NOTICE, "Compass check: pass"),
        ({"verdict": "warn"}, MavSeverity.WARNING, "Compass check: warn"),
        ({"verdict": "fail"}, MavSeverity.ERROR, "Compass check: fail"),
        ({}, MavSeverity.ERROR, "Compass check: unknown"),
    ],
)
def test_a_check_is_told_with_its_verdict(document: dict[str, str], severity: int, told: str) -> None:
    made = Task(1, CheckRequest(), "http", "")
    made.finish(True, document, None)
    assert component.outcome_texts(made) == [mav.Statustext(severity, told)]


UNSURE = replace(result(2), heading_sigma_deg=math.nan)
UNSAID = replace(result(3, accepted=False), reasons=())


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (
            task("done", results=(result(), UNSURE, UNSAID), document={"written": True}),
            [
                (MavSeverity.NOTICE, "Compass 1 calibrated, heading +-0.7 deg"),
                (MavSeverity.NOTICE, "Compass 2 calibrated"),
                (MavSeverity.ERROR, "Compass 3 not calibrated: no reason was given"),
            ],
        ),
        (task("done", results=(UNSURE,)), [(MavSeverity.WARNING, "Compass 2: solved, not written")]),
        (
            task("failed", error=f"It is {'x' * 60} and so {'on ' * 60}"),
            [
                (MavSeverity.ERROR, "calibration failed: It is"),
                (MavSeverity.ERROR, "x" * 50),
                (MavSeverity.ERROR, "and so on on on on on on on on on on on on on on"),
            ],
        ),
        (Task(1, UndoRequest("a", 1), "http", "", state="done"), []),
    ],
)
def test_the_pilot_is_told_how_it_ended_for_each_compass(made: Task, told: list[tuple[int, str]]) -> None:
    assert component.outcome_texts(made) == [mav.Statustext(*one) for one in told]


def test_names_of_values_fit_their_field() -> None:
    for value in component.heading_values(70.5, 123.4, 1.5):
        assert isinstance(value, mav.NamedValueFloat)
        assert len(value.name) <= 10
        assert value.time_boot_ms == 70500


Heard = list[mav.Message]


@pytest.fixture
def station() -> Iterator[tuple[SimulatedLink, Heard]]:
    """A link on which all that is told to ground stations is heard."""
    vehicle, heard = SimulatedAutopilot("rover", seed=1), Heard()
    vehicle.receive = lambda message, *_: heard.append(message)  # type: ignore[method-assign]
    with SimulatedLink(vehicle) as link:
        yield link, heard


def view_of(heard_s: float = 0.0) -> VehicleView:
    return VehicleView(VehicleIdentity(1, 1, "ardupilot", "rover"), "rover", 2026.0, heard_s=heard_s)


def test_the_pilot_is_told_of_a_finding_once_for_as_long_as_it_lasts(
    station: tuple[SimulatedLink, Heard],
) -> None:
    link, heard = station
    dip, field = (
        Finding(name, 1, severity, f"Compass 1: {name}", "It is off.", "")
        for name, severity in (("dip", "warning"), ("field", "bad"))
    )
    reporter = GroundStationReporter(ServiceConfig(), Desk(), Schedule())
    for at_s, findings in enumerate(((), (dip,), (dip,), (field, dip), (field,), (field, dip))):
        reporter.tell(link, view_of(), findings, float(at_s))
    told = [(message.severity, message.text) for message in heard if isinstance(message, mav.Statustext)]
    dip_told, field_told = (MavSeverity.WARNING, "Compass 1: dip"), (MavSeverity.ERROR, "Compass 1: field")
    assert told == [dip_told, field_told, dip_told]


def test_a_start_that_cannot_be_taken_now_is_rejected_for_now(station: tuple[SimulatedLink, Heard]) -> None:
    (link, heard), desk = station, Desk()
    reporter = GroundStationReporter(ServiceConfig(), desk, Schedule())
    start, view = Incoming(0.0, 255, 190, command(MavCmd.DO_START_MAG_CAL)), view_of()
    view.set_parameters({"COMPASS_OFS_X": 1.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0})
    for seen in (None, view, view):  # not heard yet; taken; stopping
        reporter.hear_command(link, seen, start, ())
        if desk.current is not None:
            desk.close("The service is stopping.")
    later = MavResult.TEMPORARILY_REJECTED
    assert [m.result for m in heard if isinstance(m, mav.CommandAck)] == [later, MavResult.ACCEPTED, later]


@pytest.mark.parametrize("solved", [True, False])
@pytest.mark.parametrize(("there", "texts", "reports"), [(True, True, 8), (True, False, 8), (False, True, 0)])
def test_progress_is_told_five_times_a_second_the_end_once_and_the_report_eight_times(
    there: bool, texts: bool, reports: int, solved: bool, station: tuple[SimulatedLink, Heard]
) -> None:
    """A second apart, as nobody acknowledges a report; none into a cut link."""
    (link, heard), desk, kinds = station, Desk(), list[Counter[type[mav.Message]]]()
    reporter = GroundStationReporter(ServiceConfig(mavlink=MavlinkConfig(statustext=texts)), desk, Schedule())
    task = desk.submit(CalibrationRequest((1,)), "http", "now")
    for tenth in range(200):
        if tenth == 10:
            desk.take()
        if tenth == 50:
            if solved:
                task.results = (result(),)
                task.finish(True, {"written": True}, None)
            else:
                task.fail(MavCompassError("Disarmed.", "Arm it."))
        reporter.tell(link, view_of(math.inf if there else 0.1 * tenth - 2.1), (), 0.1 * tenth)
        if tenth in (49, 50, 118):
            kinds.append(Counter(type(message) for message in heard))
    running, ended, later = kinds
    # Four seconds of it, and once more with the result.
    assert running[mav.MagCalProgress] == pytest.approx(20, abs=2)
    assert ended[mav.MagCalProgress] == later[mav.MagCalProgress] == running[mav.MagCalProgress] + solved
    assert ended[mav.Statustext] == later[mav.Statustext] == texts and not running[mav.Statustext]
    assert (ended[mav.MagCalReport], later[mav.MagCalReport]) == (bool(reports), reports - bool(reports))
    assert sum(isinstance(message, mav.MagCalReport) for message in heard) == reports


@pytest.mark.parametrize(("true_rad", "told_deg"), [(1.5, 85.9), (None, 57.3)])
def test_the_heading_told_is_the_true_one_where_the_declination_is_known(
    true_rad: float | None, told_deg: float, station: tuple[SimulatedLink, Heard]
) -> None:
    (link, heard), view = station, view_of()
    view.compasses[1] = LiveCompass(1)
    view.compasses[1].latest = Heading(4.5, 20.0, 1, 1.0, true_rad, 0.02, (200.0, 0.0, 400.0))
    for now_s in (5.0, 5.6):  # the latest is of a second ago, and no heading of now
        GroundStationReporter(ServiceConfig(), Desk(), Schedule()).tell(link, view, (), now_s)
    values = [message.value for message in heard if isinstance(message, mav.NamedValueFloat)]
    assert values == pytest.approx([told_deg, 1.15], abs=0.05)
