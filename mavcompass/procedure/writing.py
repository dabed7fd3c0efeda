"""Write a calibration into the vehicle, found or learnt; take it back; see it outlive a restart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult, before_and_after, summary
from mavcompass.correction import FieldCorrection
from mavcompass.enums import EkfFlag, MavCmd, MavResult
from mavcompass.errors import LinkLost, Refused, WriteFailed
from mavcompass.printable import counted
from mavcompass.procedure.autopilot_heading import OwnHeading
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import Dialect, Overrides, ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Ask, Context, Script, ask, expect, nothing, pause
from mavcompass.procedure.settings import CalibrateSettings

CANCELLED = "Cancelled."  # by the person's answer
# Of a calibration's bar: what is left is the proof, and the autopilot's own heading.
_WRITTEN = 0.9
# Until then what is heard may still be from before.
_GOING_DOWN_S = 2.5
_BACK_WITHIN_S = 60.0
_PLACE_WITHIN_S = 120.0
_RESTART = 1.0
# A heading is compared with the autopilot's over so long a rest; who does not rest is not waited for.
_REST_S, _REST_WITHIN_S = 1.5, 6.0
# Parameters travel as 32 bit floats.
_SAME = 1e-3


@dataclass(slots=True)
class Writer:
    """Write what a calibration found; `save_undo` puts the way back on disk before anything is changed.

    Attributes:
        just_before: done between a person's consent and the write.
        began, taken_back: whether values went to the vehicle, and whether the old ones are back.
    """

    desk: Desk
    save_undo: SaveUndo
    asks: bool
    just_before: Callable[[], Script[None]] = lambda: nothing(None)
    began: bool = False
    taken_back: bool = False

    def write(self, report: CalibrationReport) -> Script[CalibrationReport]:
        """Plan, ask where wanted, write and read back; without an outcome nothing was written.

        Raises WriteFailed where values were left half written.
        """
        desk = self.desk
        corrections = {result.instance: result.correction for result in report.to_write}
        turned = {r.instance: r.mounting.turned for r in report.to_write if r.mounting.turned is not None}
        plan = desk.dialect.plan(desk.parameters, corrections, turned, reporting=desk.state.reporting)
        said = {warning for result in report.results for warning in result.warnings}
        remarks = [remark for remark in plan.remarks if remark not in said]
        report = replace(report, plan=plan).noting(*plan.refusals, *remarks)
        if plan.refusals:
            return report
        if self.asks and not (yield from ask(desk.context, _question(plan, report.results))):
            return report.noting(CANCELLED)
        yield from self.just_before()
        self.began = True
        outcome = yield from desk.dialect.write(desk.context, plan, self.save_undo)
        report = replace(report, outcome=outcome)
        desk.context.show("written", "Written and read back.", _WRITTEN)
        if report.takes_effect_later:
            return report
        now = {**desk.parameters, **outcome.values}
        for instance, correction in corrections.items():
            rotation = desk.dialect.raw_rotation(now, instance)
            if rotation is None:
                if instance in turned:
                    desk.builder.turn(instance, turned[instance])
                desk.builder.set_correction(instance, correction)
            elif instance in turned:
                desk.builder.set_raw(instance, rotation, correction)
        return report

    def take_back(self, report: CalibrationReport, why: str) -> Script[None]:
        """Write the old values again. Raises WriteFailed, with the way back, where that fails."""
        assert report.outcome is not None
        yield from report.outcome.take_back(self.desk.context, why)
        self.taken_back = True


def _question(plan: ParameterPlan, results: Sequence[CalibrationResult]) -> Ask:
    about = tuple(before_and_after(result) for result in results)
    details = tuple(f"{c.name:<18} {c.old:>10.4g} -> {c.new:.4g}" for c in plan.changes)
    count = counted(len(plan.changes), "parameter")
    return Ask(f"Write the new calibration ({count})?", about, details)


def restart(
    desk: Desk, rates: MessageRates, wanted: Mapping[type[mav.Message], float], written: WriteOutcome
) -> Script[None]:
    """Restart the autopilot; wait for its heartbeat and its place, and read back what was written.

    Raises Refused where it will not, LinkLost where it does not come back, WriteFailed where it came back
    with other values.
    """
    context, starts = desk.context, desk.builder.restarts
    if desk.state.armed:
        raise Refused("The vehicle is armed: it was not restarted.", "Disarm it, then restart it.")
    knew_place = _knows_place(desk)
    context.show("restart", "Restarting the autopilot.")
    context.silent_until_s = context.now + _BACK_WITHIN_S
    number = int(MavCmd.PREFLIGHT_REBOOT_SHUTDOWN)
    context.command(number, _RESTART)
    ack = yield from expect(context, mav.CommandAck, lambda a: a.command == number, _GOING_DOWN_S)
    if ack is not None and ack.result != MavResult.ACCEPTED:
        context.silent_until_s = context.now
        raise Refused("The autopilot refused to restart.", "Restart it by its power.")
    yield from pause(context, _GOING_DOWN_S)
    if (yield from expect(context, mav.Heartbeat, timeout_s=_BACK_WITHIN_S)) is None:
        raise LinkLost("The autopilot did not come back after its restart.", "Look at its power and link.")
    context.silent_until_s = context.now
    yield from rates.ask(context, wanted)
    yield from _wait_for_place(desk, knew_place)
    if desk.builder.restarts == starts:
        raise Refused("The autopilot did not restart.", "Restart it by its power.")
    held = yield from desk.dialect.read_parameters(context, tuple(written.values))
    lost = [n for n, value in written.values.items() if n not in held or abs(held[n] - value) > 1e-3]
    if lost:
        raise WriteFailed(
            f"After the restart {lost[0]} is not what was written.",
            f"Put the old values back with: {written.restore_command}",
            written.undo_file,
            written.restore_command,
        )


def _knows_place(desk: Desk) -> bool:
    ekf = desk.state.ekf
    return ekf is not None and bool(ekf.flags & EkfFlag.POS_HORIZ_ABS)


def _wait_for_place(desk: Desk, knew_place: bool) -> Script[None]:
    """Wait until the estimator has its place again: its declination and its yaw come with it."""
    context, desk.state.ekf = desk.context, None
    end_s, told_s = context.now + _PLACE_WITHIN_S, context.now
    while knew_place and not _knows_place(desk) and context.now < end_s:
        if context.now - told_s >= 5.0:
            context.show("restart", "The autopilot is back; waiting until it knows its place.")
            told_s = context.now
        yield from pause(context, 0.5)


def write_learnt(
    context: Context,
    dialect_for: Callable[[str], Dialect],
    save_undo: SaveUndo,
    results: Sequence[CalibrationResult],
    settings: CalibrateSettings,
) -> Script[CalibrationReport]:
    """Write results that were found beforehand, with consent, into a vehicle that is disarmed.

    Of the settings `writing`, `system`, `rate_hz` and `year` are heeded.
    Raises Refused where it is armed, or another calibration is in force than the one they improve;
    LinkError where it cannot be heard; WriteFailed where values were left half written.
    """
    desk = yield from Desk.open(context, dialect_for, settings.system)
    if desk.state.heartbeat is None:
        yield from expect(context, mav.Heartbeat, timeout_s=3.0)
    _refuse_armed(desk)
    for result in results:
        if not _same(desk.dialect.correction(desk.parameters, result.instance), result.in_force):
            raise Refused(
                f"The calibration of compass {result.instance} was changed since this was learnt.",
                "Drive or fly on: it is learnt anew.",
            )
        context.show("solve", summary(result), 0.3)

    def save_if_disarmed(plan: ParameterPlan, values: Mapping[str, float], vehicle: Nameplate) -> Path:
        _refuse_armed(desk)  # the answer may have taken a while
        return save_undo(plan, values, vehicle)

    overrides = Overrides(desk.dialect, save_if_disarmed)
    rates, own = MessageRates(), OwnHeading(desk, settings.year, overrides)
    report = CalibrationReport(
        identity=desk.identity,
        results=tuple(results),
        before={result.instance: result.in_force for result in results},
        track=desk.builder.build(),
        windows=(),
        duration_s=0.0,
        vehicle=desk.vehicle,
    )
    if settings.writing == "never":
        return report
    try:
        wanted = desk.imu_rates(tuple(result.instance for result in results), settings.rate_hz)
        wanted |= {
            mav.Attitude: 10.0,
            mav.EkfStatusReport: 2.0,
            mav.SystemTime: 2.0,
            mav.GlobalPositionInt: 4.0,
        }
        yield from rates.ask(context, wanted)
        report = yield from Writer(desk, save_if_disarmed, settings.writing == "ask").write(report)
        if report.outcome is not None and (yield from _rested(desk)):
            now_s = desk.rest.time_s
            own.found(results, [(now_s - _REST_S, now_s)])
            yield from own.written(report.outcome.values)
            yield from own.settle()
            report = replace(report, heading=own.outcome())
        return replace(report, track=desk.builder.build(), duration_s=desk.duration_s())
    finally:
        yield from rates.restore(context)


def _refuse_armed(desk: Desk) -> None:
    if desk.state.armed:
        raise Refused(
            "The vehicle is armed: what was learnt is written on the ground only.",
            "Disarm it, then ask again.",
        )


def _same(one: FieldCorrection, other: FieldCorrection) -> bool:
    numbers = [np.concatenate([np.asarray(c.offsets_mgauss), c.matrix.ravel()]) for c in (one, other)]
    return bool(np.allclose(numbers[0], numbers[1], rtol=_SAME, atol=_SAME))


def _rested(desk: Desk) -> Script[bool]:
    """Wait until the vehicle has rested long enough to compare headings; False where it does not rest."""
    end_s = desk.context.now + _REST_WITHIN_S
    while desk.rest.for_s() < _REST_S and desk.context.now < end_s:
        yield from pause(desk.context, 0.2)
    return desk.rest.for_s() >= _REST_S
