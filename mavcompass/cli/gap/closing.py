"""`mavcompass gap compare`: a simulator beside the vehicle."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.gap.shared import compass_option, say_summary, showing_progress
from mavcompass.cli.options import Output, common_options
from mavcompass.cli.source import require_for
from mavcompass.installation.invocation import program

if TYPE_CHECKING:
    from mavcompass.gap.comparison import Comparison


@click.command()
@click.argument("simulator", metavar="SIM", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("vehicle", metavar="REAL", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument(
    "again", metavar="[SIM2]...", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@compass_option
@click.option("--report", type=click.Path(dir_okay=False, path_type=Path), help="Write an HTML report.")
@common_options
def compare(
    simulator: Path,
    vehicle: Path,
    again: tuple[Path, ...],
    instance: int,
    report: Path | None,
    output: Output,
) -> None:
    """Say what a simulator's recording lacks beside the vehicle's, and the vehicle's beside it.

    SIM2, the simulator flown again with what `gap export REAL --baseline SIM` wrote, tells how much of the
    promised shrink was achieved. Trajectory, place and rates may differ.

    \b
    Example: mavcompass gap compare sitl.tlog flight.tlog sitl_again.tlog --report closed.html
    """
    require_for(simulator, vehicle, *again, report=report)
    with showing_progress(vehicle.name) as progress:
        from mavcompass.gap.comparison import compare as compared
        from mavcompass.logs import read_track

        tracks = [read_track(log) for log in (simulator, vehicle, *again)]
        comparison = compared(tracks[0], tracks[1], tracks[2:], instance, progress)
    say_comparison(comparison, output)
    if not again and any(d.lacks == "simulator" for d in comparison.differences):
        logs = f"{shlex.quote(str(vehicle))} --baseline {shlex.quote(str(simulator))}"
        output.say(f"  next: {program()} gap export {logs} --to ardupilot-sitl found.parm")
    output.write_json(comparison.to_json())
    write_report(comparison, report, output)


def say_comparison(comparison: Comparison, output: Output) -> None:
    """Say what to do, and how the two differ."""
    from mavcompass.report.compare_words import compare_summary

    say_summary(compare_summary(comparison), output)


def write_report(comparison: Comparison, report: Path | None, output: Output) -> None:
    """Write the report where one is wanted."""
    if report is None:
        return
    from mavcompass.report.compare import write_compare_report

    write_compare_report(comparison, report)
    output.say(f"Report: {report}")
