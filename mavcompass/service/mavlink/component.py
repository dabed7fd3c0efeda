"""The service as a MAVLink component: what ground stations ask of it, and what it tells them.

It speaks the messages of ArduPilot's own compass calibration, so that the bars and reports of
QGroundControl and Mission Planner work as they do with the autopilot.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.enums import MagCalStatus, MavCmd, MavResult, MavSeverity
from mavcompass.errors import MavCompassError
from mavcompass.messages import Incoming
from mavcompass.service.config import ServiceConfig
from mavcompass.service.view import GONE_S, VehicleView
from mavcompass.service.watch import Finding
from mavcompass.service.work.clock import Schedule, utc_now
from mavcompass.service.work.tasks import LEARNT, CalibrationRequest, Desk, Task
from mavcompass.vehicle.link import Link

_log = logging.getLogger(__name__)

HEADING_NAME = "MC_HDG"
SIGMA_NAME = "MC_HDG_SD"
_SECTIONS = 80  # bits of MAG_CAL_PROGRESS.completion_mask
_TEXT_LENGTH = 50
_PROGRESS_EVERY_S = 0.2
# A report is sent several times: nobody acknowledges it, and links lose messages.
_REPORT_TIMES, _REPORT_EVERY_S = 8, 1.0


# What a ground station wants: a calibration, its result accepted, the one under way ended; or nothing.
Order = CalibrationRequest | Literal["accept", "cancel"] | None


def as_long(message: mav.Message) -> mav.CommandLong | None:
    """Read COMMAND_LONG or COMMAND_INT as the former; None for any other message."""
    if isinstance(message, mav.CommandLong):
        return message
    if isinstance(message, mav.CommandInt):
        c = message
        return mav.CommandLong(
            c.target_system, c.target_component, c.command, 0, c.param1, c.param2, c.param3, c.param4
        )
    return None


def answer(
    command: mav.CommandLong,
    task: Task | None,
    compasses: Sequence[int],
    accept_commands: bool,
    offered: Sequence[int] = (),
) -> tuple[MavResult, Order]:
    """Decide on a command addressed to this component: its answer, and what is to be done about it.

    `task` is the one under way or the last one, `compasses` those that the vehicle has, `offered` those for
    which something better was learnt: to accept that is consent to have it written.
    """
    calibrating = task is not None and not task.finished and task.request.kind == "calibration"
    match command.command:
        case MavCmd.DO_START_MAG_CAL:
            if not accept_commands:
                return MavResult.DENIED, None
            if task is not None and not task.finished:
                return MavResult.TEMPORARILY_REJECTED, None
            return _start(command, compasses)
        case MavCmd.DO_ACCEPT_MAG_CAL:
            # Before there is a result the question is another one, which a station cannot know.
            if task is not None and task.question is not None and calibrating and task.results:
                return MavResult.ACCEPTED, "accept"
            if offered and accept_commands and (task is None or task.finished):
                wanted = CalibrationRequest(compasses=tuple(offered), writing="yes", method=LEARNT)
                return MavResult.ACCEPTED, wanted
            return MavResult.FAILED, None
        case MavCmd.DO_CANCEL_MAG_CAL:
            # Cancelling what is not running is no mistake: stations send it to be sure.
            return MavResult.ACCEPTED, "cancel" if calibrating else None
    return MavResult.UNSUPPORTED, None


def _start(command: mav.CommandLong, compasses: Sequence[int]) -> tuple[MavResult, Order]:
    """Read DO_START_MAG_CAL: mask (0 is all), retry, autosave, delay, autoreboot."""
    values = (command.param1, command.param2, command.param3, command.param4)
    if not all(math.isfinite(value) for value in values) or not 0.0 <= command.param1 <= 255.0:
        return MavResult.DENIED, None
    mask = int(command.param1)
    chosen = tuple(i for i in compasses if not mask or mask & (1 << (i - 1)))
    if mask and mask != sum(1 << (i - 1) for i in chosen):
        return MavResult.FAILED, None  # a compass that the vehicle does not have
    writing: Literal["yes", "ask"] = "yes" if command.param3 else "ask"
    return MavResult.ACCEPTED, CalibrationRequest(compasses=chosen, writing=writing)


def progress(task: Task, compasses: Sequence[int]) -> list[mav.Message]:
    """Tell how far a calibration is, per compass, as MAG_CAL_PROGRESS."""
    solved = bool(task.results)
    percent = 100 if solved else min(99, round(100.0 * task.fraction))
    full = round(_SECTIONS * percent / 100.0)
    bits = (1 << full) - 1
    return [
        mav.MagCalProgress(
            compass_id=instance - 1,
            cal_mask=_mask(compasses),
            cal_status=MagCalStatus.RUNNING_STEP_TWO if solved else MagCalStatus.RUNNING_STEP_ONE,
            attempt=1,
            completion_pct=percent,
            completion_mask=tuple((bits >> (8 * byte)) & 0xFF for byte in range(10)),
        )
        for instance in compasses
    ]


def reports(task: Task, compasses: Sequence[int]) -> list[mav.Message]:
    """Tell what a calibration found, per compass, as MAG_CAL_REPORT.

    The numbers are those of the JSON, in single precision; `autosaved` says whether they are in force.
    """
    written = bool(task.document and task.document.get("written"))
    found: Mapping[int, CalibrationResult] = {result.instance: result for result in task.results}
    return [_report(i, _mask(compasses), found.get(i), written, task) for i in compasses]


def _report(
    instance: int, mask: int, result: CalibrationResult | None, written: bool, task: Task
) -> mav.MagCalReport:
    if result is None:
        return mav.MagCalReport(instance - 1, mask, MagCalStatus.FAILED)
    good = result.accepted and (task.ok or not task.finished)
    c = result.correction
    fitness = result.residual_rms_mgauss
    return mav.MagCalReport(
        instance - 1,
        mask,
        MagCalStatus.SUCCESS if good else MagCalStatus.FAILED,
        int(written),
        fitness if math.isfinite(fitness) else 0.0,
        *c.offsets_mgauss,
        *c.diagonals,
        *c.off_diagonals,
        scale_factor=c.scale,
    )


def _mask(compasses: Sequence[int]) -> int:
    return sum(1 << (instance - 1) for instance in compasses)


def heading_values(boot_s: float, heading_deg: float, sigma_deg: float) -> list[mav.Message]:
    """Tell the heading and its sigma as NAMED_VALUE_FLOAT, degrees."""
    boot_ms = round(boot_s * 1000.0) & 0xFFFFFFFF
    return [
        mav.NamedValueFloat(boot_ms, HEADING_NAME, heading_deg),
        mav.NamedValueFloat(boot_ms, SIGMA_NAME, sigma_deg),
    ]


def finding_text(finding: Finding) -> mav.Statustext:
    """Tell the pilot what the watch found."""
    severity = MavSeverity.ERROR if finding.severity == "bad" else MavSeverity.WARNING
    return mav.Statustext(severity, finding.short[:_TEXT_LENGTH])


def outcome_texts(task: Task) -> list[mav.Message]:
    """Tell the pilot how a calibration or a check ended."""
    if task.state == "failed":
        return _texts(MavSeverity.ERROR, f"{task.request.kind} failed: {task.error}")
    document: Mapping[str, Any] = task.document or {}
    if task.request.kind == "check":
        verdict = document.get("verdict", "unknown")
        severity = {"pass": MavSeverity.NOTICE, "warn": MavSeverity.WARNING}.get(verdict, MavSeverity.ERROR)
        return _texts(severity, f"Compass check: {verdict}")
    if task.request.kind != "calibration":
        return []
    messages: list[mav.Message] = []
    for result in task.results:
        name = f"Compass {result.instance}"
        if not result.accepted:
            why = result.reasons[0] if result.reasons else "no reason was given"
            messages += _texts(MavSeverity.ERROR, f"{name} not calibrated: {why}")
        elif document.get("written"):
            sigma = f", heading +-{result.heading_sigma_deg:.1f} deg"
            known = math.isfinite(result.heading_sigma_deg)
            messages += _texts(MavSeverity.NOTICE, f"{name} calibrated{sigma if known else ''}")
        else:
            messages += _texts(MavSeverity.WARNING, f"{name}: solved, not written")
    return messages


def _texts(severity: MavSeverity, text: str) -> list[mav.Message]:
    """Cut a sentence into messages of at most 50 letters, between words, three at the most."""
    lines: list[str] = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) <= _TEXT_LENGTH:
            lines[-1] = longer
        else:
            lines.append(word[:_TEXT_LENGTH])
    return [mav.Statustext(severity, line) for line in lines[:3]]


class GroundStationReporter:
    """Tell ground stations what is new to them, and do what they command."""

    def __init__(self, config: ServiceConfig, desk: Desk, due: Schedule) -> None:
        self._config = config
        self._desk = desk
        self._due = due
        self._announced: set[tuple[str, int]] = set()
        self._stage: tuple[int, bool] | None = None
        self._times: int  # of the report, in this stage

    def tell(self, link: Link, view: VehicleView, findings: Sequence[Finding], now_s: float) -> None:
        """Send what is due now."""
        self._announce(link, findings)
        self._heading(link, view, now_s)
        task = self._desk.current
        if task is not None and task.state != "waiting":
            self._task(link, view, task, now_s)

    def _announce(self, link: Link, findings: Sequence[Finding]) -> None:
        """Tell the pilot of findings that are new."""
        for finding in findings:
            if (finding.id, finding.instance) not in self._announced:
                _log.warning("%s %s", finding.text, finding.remedy)
                if self._config.mavlink.statustext:
                    link.send(finding_text(finding))
        self._announced = {(finding.id, finding.instance) for finding in findings}

    def _heading(self, link: Link, view: VehicleView, now_s: float) -> None:
        rate_hz = self._config.mavlink.heading_hz
        if not rate_hz or not self._due.is_due("heading", now_s, 1.0 / rate_hz):
            return
        first = view.compasses.get(1)
        heading = None if first is None else first.latest
        if heading is not None and now_s - heading.time_s < 1.0:
            angle_rad = heading.magnetic_rad if heading.true_rad is None else heading.true_rad
            for value in heading_values(
                heading.boot_s, math.degrees(angle_rad), math.degrees(heading.sigma_rad)
            ):
                link.send(value)

    def _task(self, link: Link, view: VehicleView, task: Task, now_s: float) -> None:
        """Send a calibration's progress while it runs, and its report when there is one."""
        is_calibration = isinstance(task.request, CalibrationRequest)
        compasses = self._compasses(task, view) if is_calibration else ()
        if not task.finished and task.state != "asking":
            if self._due.is_due("progress", now_s, _PROGRESS_EVERY_S):
                _send(link, progress(task, compasses))
            return
        if (stage := (task.number, task.finished)) != self._stage:
            self._stage, self._times = stage, 0
            self._due.hurry("report")
            if task.results:
                _send(link, progress(task, compasses))
            if task.finished and self._config.mavlink.statustext:
                _send(link, outcome_texts(task))
        there = now_s - view.heard_s < GONE_S  # a report sent into a cut link is lost
        if is_calibration and there and self._times < _REPORT_TIMES:
            if self._due.is_due("report", now_s, _REPORT_EVERY_S):
                self._times += 1
                _send(link, reports(task, compasses))

    def _compasses(self, task: Task, view: VehicleView) -> tuple[int, ...]:
        assert isinstance(task.request, CalibrationRequest)
        return task.request.compasses or self._config.vehicle.compasses or view.instances()

    # --- commands -----------------------------------------------------------------------------------

    def hear_command(
        self, link: Link, view: VehicleView | None, heard: Incoming, offered: Sequence[int]
    ) -> None:
        """Answer a command that is addressed to this component; pass over anything else.

        `offered` are the compasses for which something better was learnt.
        """
        command = as_long(heard.message)
        address = (link.identity.spoken_system, link.identity.component)
        if command is None or (command.target_system, command.target_component) != address:
            return
        task = self._desk.current
        compasses = () if view is None else self._config.vehicle.compasses or view.instances()
        accepts = self._config.mavlink.accept_commands
        result, order = answer(command, task, compasses, accepts, offered)
        result = self._obey(order, result, task)
        link.send(mav.CommandAck(command.command, result, 0, 0, heard.system, heard.component))

    def _obey(self, order: Order, result: MavResult, task: Task | None) -> MavResult:
        match order:
            case CalibrationRequest(compasses=()):
                return MavResult.TEMPORARILY_REJECTED  # the vehicle is not known yet
            case CalibrationRequest():
                try:
                    self._desk.submit(order, "mavlink", utc_now())
                except MavCompassError:
                    return MavResult.TEMPORARILY_REJECTED  # another was faster, or the service is stopping
            case "accept" if task is not None and not task.give_answer(True):
                return MavResult.TEMPORARILY_REJECTED
            case "cancel" if task is not None and not task.give_answer(False):
                task.stop.reason = "Cancelled by the ground station."
        return result


def _send(link: Link, messages: Sequence[mav.Message]) -> None:
    for message in messages:
        link.send(message)
