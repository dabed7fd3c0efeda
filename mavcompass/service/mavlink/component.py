"""The service as a MAVLink component: what ground stations ask of it, and what it tells them.

It speaks the messages of ArduPilot's own compass calibration, so that the bars and reports of
QGroundControl and Mission Planner work as they do with the autopilot. Nothing here sends or waits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.enums import MagCalStatus, MavCmd, MavResult, MavSeverity
from mavcompass.service.watch import Finding
from mavcompass.service.work.tasks import LEARNT, CalibrationRequest, Task

HEADING_NAME = "MC_HDG"
SIGMA_NAME = "MC_HDG_SD"
_SECTIONS = 80  # bits of MAG_CAL_PROGRESS.completion_mask
_TEXT_LENGTH = 50


@dataclass(frozen=True, slots=True)
class Order:
    """Hold what a ground station wants: a calibration to start, its result accepted, or an end."""

    verb: Literal["start", "accept", "cancel"]
    request: CalibrationRequest | None = None


@dataclass(frozen=True, slots=True)
class Reply:
    """Hold the answer to a command, and what is to be done about it."""

    result: MavResult
    order: Order | None = None


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
) -> Reply:
    """Decide on a command addressed to this component.

    `task` is the one under way or the last one, `compasses` those that the vehicle has, `offered` those for
    which something better was learnt: to accept that is consent to have it written.
    """
    calibrating = task is not None and not task.finished and task.request.kind == "calibration"
    match command.command:
        case MavCmd.DO_START_MAG_CAL:
            if not accept_commands:
                return Reply(MavResult.DENIED)
            if task is not None and not task.finished:
                return Reply(MavResult.TEMPORARILY_REJECTED)
            return _start(command, compasses)
        case MavCmd.DO_ACCEPT_MAG_CAL:
            # Before there is a result the question is another one, which a station cannot know.
            if task is not None and task.question is not None and calibrating and task.results:
                return Reply(MavResult.ACCEPTED, Order("accept"))
            if offered and accept_commands and (task is None or task.finished):
                request = CalibrationRequest(compasses=tuple(offered), writing="yes", method=LEARNT)
                return Reply(MavResult.ACCEPTED, Order("start", request))
            return Reply(MavResult.FAILED)
        case MavCmd.DO_CANCEL_MAG_CAL:
            # Cancelling what is not running is no mistake: stations send it to be sure.
            return Reply(MavResult.ACCEPTED, Order("cancel") if calibrating else None)
    return Reply(MavResult.UNSUPPORTED)


def _start(command: mav.CommandLong, compasses: Sequence[int]) -> Reply:
    """Read DO_START_MAG_CAL: mask (0 is all), retry, autosave, delay, autoreboot."""
    values = (command.param1, command.param2, command.param3, command.param4)
    if not all(math.isfinite(value) for value in values) or not 0.0 <= command.param1 <= 255.0:
        return Reply(MavResult.DENIED)
    mask = int(command.param1)
    chosen = tuple(i for i in compasses if not mask or mask & (1 << (i - 1)))
    if mask and mask != sum(1 << (i - 1) for i in chosen):
        return Reply(MavResult.FAILED)  # a compass that the vehicle does not have
    writing: Literal["yes", "ask"] = "yes" if command.param3 else "ask"
    return Reply(MavResult.ACCEPTED, Order("start", CalibrationRequest(compasses=chosen, writing=writing)))


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
    good = result.accepted and (task.state != "failed") and (task.ok or not task.finished)
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
