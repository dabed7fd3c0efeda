"""What the commands about the gap share: options, a diagnosis of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import THERE, Output, Whole
from mavcompass.cli.terminal.lines import showing_progress, styled

if TYPE_CHECKING:
    from mavcompass.gap.comparison import Comparison
    from mavcompass.gap.result import Diagnosis

compass_option = click.option(
    "--compass", "instance", type=Whole(1, 3), default=1, show_default=True, help="Which compass."
)
baseline_option = click.option(
    "--baseline",
    type=THERE,
    help="A recording of the same vehicle that is accepted as good: gives the noise floor.",
)


def diagnosed(
    log: Path,
    instance: int,
    baseline: Path | None,
    withhold: tuple[str, ...],
    reference: str,
    thorough: bool = False,
) -> Diagnosis:
    """Read a recording and diagnose it, saying what is being done."""
    with showing_progress(log.name) as progress:
        from mavcompass.gap.diagnose import diagnose_gap, withheld_effects
        from mavcompass.logs import read_track

        withheld_effects(withhold)  # a wrong name is said before a long recording is read
        track = read_track(log)
        before = read_track(baseline) if baseline is not None else None
        return diagnose_gap(
            track, before, withhold, instance, reference,  # type: ignore[arg-type]
            thorough=thorough, progress=progress,
        )  # fmt: skip


def say_summary(lines: list[str], output: Output, colour: str | None = None) -> None:
    """Say what to do, which is the first line, and why."""
    output.say(styled(lines[0], bold=True, fg=colour), *lines[1:])


def say_comparison(comparison: Comparison, output: Output) -> None:
    """Say what to do, and how the two differ."""
    from mavcompass.report.compare import compare_summary

    say_summary(compare_summary(comparison), output)


def write_report(comparison: Comparison, report: Path | None, output: Output) -> None:
    """Write the report where one is wanted."""
    if report is None:
        return
    from mavcompass.report.compare import write_compare_report

    write_compare_report(comparison, report)
    output.say(f"Report: {report}")
