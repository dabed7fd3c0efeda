"""Write a calibration into the vehicle, and take it back where it is not proven."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mavcompass.errors import LinkError, WriteFailed
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import ParameterPlan, SaveUndo
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Script, ask


@dataclass(slots=True)
class Writer:
    """Write what a calibration found; `save_undo` puts the way back on disk before anything is changed."""

    desk: Desk
    save_undo: SaveUndo
    asks: bool

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
        if self.asks and not (yield from ask(desk.context, _question(plan))):
            return report.noting("Not written: the answer was no.")
        outcome = yield from desk.dialect.write(desk.context, plan, self.save_undo)
        report = replace(report, outcome=outcome)
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
        assert report.plan is not None and report.outcome is not None
        self.desk.context.show("undo", f"{why} Putting the old values back.")
        try:
            yield from self.desk.dialect.write(self.desk.context, report.plan.reversed(), self.save_undo)
        except (WriteFailed, LinkError) as trouble:
            outcome = report.outcome
            raise WriteFailed(
                f"{why} The new values could not be taken back: {trouble.what}",
                f"Bring the link back, then put the old values back with: {outcome.restore_command}",
                outcome.undo_file,
                outcome.restore_command,
            ) from trouble


def _question(plan: ParameterPlan) -> str:
    lines = [f"  {c.name:<18} {c.old:>10.4g} -> {c.new:.4g}" for c in plan.changes]
    return "\n".join(["Write these parameters?", *lines])
