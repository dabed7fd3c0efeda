"""A calibration in a terminal's words: what was found, what was written, how to undo it."""

from __future__ import annotations

from mavcompass.calibration.result import CalibrationResult, summary
from mavcompass.cli.options import Output
from mavcompass.cli.terminal.colour import styled
from mavcompass.procedure.report import CalibrationReport


def say_result(output: Output, result: CalibrationResult) -> None:
    """Say one compass's result, with its reasons and warnings."""
    output.say(styled(summary(result), fg="green" if result.accepted else "red"))
    for reason in (*result.reasons, *result.warnings):
        output.say(f"  - {reason}")


def say_outcome(output: Output, report: CalibrationReport) -> None:
    """Say what became of a vehicle's parameters."""
    outcome = report.outcome
    if report.written and outcome is not None:
        output.say("Written and read back.")
        for line in _mounting(report):
            output.say(line)
        if report.proof is not None:
            output.say(report.proof.summary())
        if outcome.undo_file is not None:
            output.say(f"To undo: {outcome.restore_command}")
        if report.heading is not None:
            said = report.heading.summary()
            output.say(styled(said, fg="red") if report.steers_off else said)
            if report.heading.not_loaded:
                output.say(f"Land and disarm it, then: {outcome.again_command}", "Or let it land: --land.")
    elif report.undone:
        output.say("The old values are back on the vehicle: nothing has changed.")
    else:
        output.say("Nothing written.")
        if report.heading is not None and report.heading.known:
            output.say(report.heading.summary())


def _mounting(report: CalibrationReport) -> list[str]:
    """Say how a compass was set to be mounted, where that was written too."""
    found = [name for r in report.results for name in r.mounting.setting]
    changes = [] if report.plan is None else [c for c in report.plan.changes if c.name in found]
    return [f"Mounted otherwise than was set: {c.name} {c.old:g} -> {c.new:g}." for c in changes]
