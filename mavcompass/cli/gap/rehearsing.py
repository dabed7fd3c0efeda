"""`mavcompass gap rehearse`: the heading error to expect of a calibration of this vehicle."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from mavcompass.cli.gap.shared import baseline_option, compass_option, say_summary, showing_progress
from mavcompass.cli.options import Output, Whole, common_options
from mavcompass.cli.source import reference_option, require_for
from mavcompass.cli.terminal.colour import is_live
from mavcompass.errors import UsageError


@click.command()
@click.argument("log", metavar="LOG", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@compass_option
@baseline_option
@click.option("--draws", type=Whole(20, 100_000), default=1000, show_default=True, help="How many vehicles.")
@click.option("--seed", type=Whole(0), default=1, show_default=True, help="Of the draws.")
@reference_option
@click.option("--report", type=click.Path(dir_okay=False, path_type=Path), help="Write an HTML report.")
@common_options
def rehearse(
    log: Path,
    instance: int,
    baseline: Path | None,
    draws: int,
    seed: int,
    reference: str,
    report: Path | None,
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
            require_for(diagnosis.recording, report=report)
            track = read_track(diagnosis.recording)
        else:
            require_for(log, baseline, report=report)
            track = read_track(log)
            before = read_track(baseline) if baseline is not None else None
            diagnosis = diagnose_gap(
                track, before, (), instance, reference,  # type: ignore[arg-type]
                progress=progress,
            )  # fmt: skip
    with _counting() as count:
        result = rehearsed(track, diagnosis, draws, seed, reference, count)  # type: ignore[arg-type]
    from mavcompass.report.rehearsal import rehearsal_summary, write_rehearsal_report

    say_summary(rehearsal_summary(result), output)
    output.write_json(result.to_json())
    if report is not None:
        write_rehearsal_report(result, report)
        output.say(f"Report: {report}")


@contextmanager
def _counting() -> Iterator[Callable[[int, int], None]]:
    """Show a bar of what is done on a terminal, nothing in a pipe."""
    if not is_live():
        yield lambda done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, no_color=bool(os.environ.get("NO_COLOR")))
    columns = (
        BarColumn(bar_width=24), MofNCompleteColumn(), TextColumn("calibrations"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, of: bar.update(task, total=of, completed=done)
