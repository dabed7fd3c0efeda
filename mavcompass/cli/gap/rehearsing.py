"""`mavcompass gap rehearse`: the heading error to expect of a calibration of this vehicle."""

from __future__ import annotations

from pathlib import Path

import click

from mavcompass.cli.gap.shared import baseline_option, compass_option, say_summary, showing_progress
from mavcompass.cli.options import THERE, Output, Whole, common_options, report_option
from mavcompass.cli.source import reference_option, require_for
from mavcompass.cli.terminal.bar import bar
from mavcompass.errors import UsageError


@click.command()
@click.argument("log", metavar="LOG", type=THERE)
@compass_option
@baseline_option
@click.option("--draws", type=Whole(20, 100_000), default=1000, show_default=True, help="How many vehicles.")
@click.option("--seed", type=Whole(0), default=1, show_default=True, help="Of the draws.")
@reference_option
@report_option
@common_options
def rehearse(
    log: Path,
    instance: int,
    baseline: Path | None,
    draws: int,
    seed: int,
    reference: str,
    report_file: Path | None,
    output: Output,
) -> None:
    """Calibrate LOG's vehicle a thousand times in the simulation: the heading error to expect, and why.

    LOG is a recording, which is diagnosed, or a diagnosis that `gap diagnose --json` wrote, with its
    recording at hand. Vehicles of its kind are drawn from what the diagnosis leaves open, and each goes
    through the four positions as this vehicle stands. Each effect and each source of error is taken out in
    turn, and what could be done otherwise is tried.

    \b
    Example: mavcompass gap rehearse flight.tlog --baseline good.tlog --report rehearsal.html
    """
    with showing_progress(log.name) as progress:
        from mavcompass.gap import diagnose_gap
        from mavcompass.gap.rehearsal import Stored, read_stored
        from mavcompass.gap.rehearsal import rehearse as rehearsed
        from mavcompass.gap.result import Diagnosis
        from mavcompass.logs import read_track

        diagnosis: Diagnosis | Stored
        if log.suffix == ".json":
            if baseline is not None:
                raise UsageError(
                    "The baseline belongs to the diagnosis.", "Give --baseline to `mavcompass gap diagnose`."
                )
            diagnosis = read_stored(log)
            require_for(diagnosis.recording, report=report_file)
            track = read_track(diagnosis.recording)
        else:
            require_for(log, baseline, report=report_file)
            track = read_track(log)
            before = read_track(baseline) if baseline is not None else None
            diagnosis = diagnose_gap(
                track, before, (), instance, reference,  # type: ignore[arg-type]
                progress=progress,
            )  # fmt: skip
    with bar() as draw:
        result = rehearsed(
            track, diagnosis, draws, seed, reference,  # type: ignore[arg-type]
            lambda done, of: draw(done, of, "calibrations"),
        )  # fmt: skip
    from mavcompass.report.rehearsal import rehearsal_summary, write_rehearsal_report

    say_summary(rehearsal_summary(result), output)
    output.write_json(result.to_json())
    if report_file is not None:
        write_rehearsal_report(result, report_file)
        output.say(f"Report: {report_file}")
