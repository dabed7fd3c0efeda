"""Write a calibration into the vehicle, and take it back where it is not proven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mavcompass.calibration.result import CalibrationResult, before_and_after
from mavcompass.printable import counted
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Ask, Script, ask, nothing

CANCELLED = "Cancelled."  # by the person's answer
# Of a calibration's bar: what is left is the proof, and the autopilot's own heading.
_WRITTEN = 0.9


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
