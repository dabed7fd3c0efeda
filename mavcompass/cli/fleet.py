"""`mavcompass fleet ...`: many recordings, on one machine or a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import FILE, Commands, Function, Number, Output, Whole, common_options, gathered
from mavcompass.cli.source import (
    max_error_option,
    method_option,
    recorded_compass_option,
    reference_option,
    require_for,
)
from mavcompass.cli.terminal.lines import bar
from mavcompass.printable import counted

if TYPE_CHECKING:
    from mavcompass.fleet.examine import Job, Row
    from mavcompass.fleet.run import FleetResult, Progress
    from mavcompass.fleet.summary import Summary, Vehicle

NOTHING_USABLE = 4
_SHOWN = 5
LONG_S = 20.0  # from here on a recording is named


@click.group(cls=Commands)
def command() -> None:
    """Work through many recordings: a row for each in a Parquet file, and a summary page.

    PATHS are files, folders, patterns ("flights/**/*.tlog") or the same in an object store (s3://...).
    A recording that cannot be used, or that kills the process that reads it, costs only itself. A run that
    was stopped goes on when the same command is given again: what is done is kept in FILE.parquet.journal.

    \b
    Example: mavcompass fleet calibrate flights/ --out fleet.parquet
    """


@dataclass(frozen=True, slots=True)
class Asked:
    """Hold what all work on fleets is asked: of which recordings, where, how."""

    paths: tuple[str, ...]
    out: Path
    workers: int | None
    scheduler: str | None
    timeout_s: float
    instances: tuple[int, ...]
    vehicle_pattern: str | None
    fresh: bool
    retry_errors: bool
    report_file: Path | None

    @property
    def page(self) -> Path:
        """Return where the summary page goes."""
        return self.report_file or self.out.with_suffix(".html")


def fleet_options(function: Function) -> Function:
    """Let a command take what all work on fleets shares; the function gets the argument `asked: Asked`."""
    options = (
        click.argument("paths", nargs=-1, required=True),
        click.option(
            "--out",
            type=FILE,
            required=True,
            metavar="FILE.parquet",
            help="The table; its journal FILE.parquet.journal stands beside it.",
        ),
        click.option("--workers", type=Whole(1, 1024), help="Processes here (default: one per processor)."),
        click.option("--scheduler", metavar="ADDRESS", help="Use this Dask cluster, e.g. tcp://HOST:8786."),
        click.option(
            "--timeout",
            "timeout_s",
            type=Number(0.1),
            default=600.0,
            show_default=True,
            help="Give a recording up after so many seconds.",
        ),
        recorded_compass_option,
        click.option(
            "--vehicle-pattern",
            metavar="REGEX",
            help="Its first group, found in a path, names the vehicle (default: serial number, or folder).",
        ),
        click.option("--fresh", is_flag=True, help="Forget the journal and begin anew."),
        click.option("--retry-errors", is_flag=True, help="Do again what gave an error."),
        click.option(
            "--report",
            "report_file",
            type=FILE,
            help="The summary page (default: FILE.html).",
        ),
    )
    for option in (gathered(Asked, "asked"), common_options, *reversed(options)):
        function = option(function)
    return function


@command.command()
@fleet_options
@method_option
@max_error_option
def calibrate(
    asked: Asked,
    method: str,
    max_error_deg: float,
    output: Output,
) -> int:
    """Calibrate every recording; see how each vehicle's calibration moves over time. Nothing is written
    to a vehicle.

    \b
    Example: mavcompass fleet calibrate flights/ --out fleet.parquet --workers 8
    """
    from mavcompass.fleet.examine import Job

    pattern = asked.vehicle_pattern
    job = Job(
        "calibrate", asked.instances, method=method, max_error_deg=max_error_deg, vehicle_pattern=pattern
    )
    return _run(job, asked, output)


@command.command()
@fleet_options
@reference_option
@click.option(
    "--distribution",
    "distribution_file",
    type=FILE,
    metavar="FILE.json",
    help="What the vehicles have in common (default: beside the table, FILE.distribution.json).",
)
@click.option(
    "--presets",
    type=Whole(0, 10_000),
    default=0,
    metavar="N",
    help="Draw N vehicles of the fleet as presets for `simulate --effect @FILE`, beside the distribution.",
)
def diagnose(
    asked: Asked,
    reference: str,
    distribution_file: Path | None,
    presets: int,
    output: Output,
) -> int:
    """Diagnose the sim-to-real gap of every recording: which effects, how large, on which vehicles.

    What the vehicles have in common is learnt as a distribution, for domain randomisation, and the vehicle
    that is not like the others is named.

    \b
    Example: mavcompass fleet diagnose "flights/**/*.BIN" --out gaps.parquet --scheduler tcp://10.0.0.5:8786
    """
    from mavcompass.fleet.examine import Job

    job = Job("diagnose", asked.instances, reference=reference, vehicle_pattern=asked.vehicle_pattern)
    return _run(job, asked, output, distribution_file or asked.out.with_suffix(".distribution.json"), presets)


def _run(job: Job, asked: Asked, output: Output, distribution: Path | None = None, presets: int = 0) -> int:
    """Do the work; what vehicles have in common goes to `distribution`, beside `presets` drawn from that."""
    if asked.workers is not None and asked.scheduler is not None:
        raise click.UsageError("--workers and --scheduler exclude each other: a cluster has its own workers.")
    from mavcompass.fleet.engine import Engine
    from mavcompass.fleet.recordings import find_recordings
    from mavcompass.fleet.run import journal_of, run_fleet
    from mavcompass.fleet.summary import summarise
    from mavcompass.report.fleet import write_fleet_report

    out, page = asked.out, asked.page
    engine = Engine(asked.workers or len(os.sched_getaffinity(0)), asked.scheduler, asked.timeout_s)
    cluster = () if engine.scheduler is None else ("A cluster (--scheduler)",)
    require_for(report=page, also=("A fleet", "A Parquet table", *cluster))
    recordings = find_recordings(asked.paths)
    if engine.scheduler is None:  # a cluster's workers have their own installation
        require_for(*(Path(recording.path) for recording in recordings))

    def write_page(rows: list[Row], progress: Progress) -> None:
        longest = ", ".join(f"{_short(path)} ({seconds:.0f} s)" for path, seconds in progress.under_way[:3])
        so_far = {"Still at work": f"{progress.done} of {progress.asked} done; now: {longest or 'the rest'}"}
        write_fleet_report(summarise(rows, job.work), so_far, page)

    with showing() as show:
        try:
            result = run_fleet(
                job,
                recordings,
                out,
                engine,
                fresh=asked.fresh,
                retry_errors=asked.retry_errors,
                on_progress=show,
                on_rows=write_page,
            )
        except KeyboardInterrupt:
            output.say(f"What is done is kept in {journal_of(out)}; the same command goes on from there.")
            raise
    summary = summarise(result.rows, job.work)
    facts = {"Table": str(out), "Work": job.work, "Examined now": f"{result.examined}, kept: {result.kept}"}
    if slow := [
        f"{_short(path)} ({seconds:.0f} s)" for path, seconds in summary.slowest if seconds >= LONG_S
    ]:
        facts["Slowest"] = ", ".join(slow)
    if distribution is not None and summary.population is not None:
        from mavcompass.fleet.population import write_distribution

        written = write_distribution(summary.population, distribution, presets)
        drawn = f" and {len(written) - 1} presets" if presets else ""
        facts["Distribution"] = f"{distribution}{drawn}"
    write_fleet_report(summary, facts, page)
    _say(output, result, summary, out, page)
    if "Distribution" in facts:
        output.say(f"Distribution: {facts['Distribution']}")
    output.write_json(_document(result, summary, out, page))
    return NOTHING_USABLE if result.rows and all(row["status"] == "error" for row in result.rows) else 0


@contextmanager
def showing() -> Iterator[Callable[[Progress], None]]:
    """Show a bar on a terminal, nothing in a pipe."""
    with bar() as draw:

        def show(progress: Progress) -> None:
            words = [counted(progress.errors, "error")] if progress.errors else []
            if progress.under_way and progress.under_way[0][1] >= LONG_S:
                path, seconds = progress.under_way[0]
                words.append(f"{_short(path)} takes {seconds:.0f} s so far")
            draw(progress.done, progress.asked, ", ".join(words))

        yield show


def _short(path: str) -> str:
    """Name a recording by its file and folder."""
    return "/".join(Path(path).parts[-2:])


def _say(output: Output, result: FleetResult, summary: Summary, out: Path, page: Path) -> None:
    from mavcompass.fleet.summary import LEAST_MGAUSS

    kept = f", {result.kept} were done before" if result.kept else ""
    fruitless = ""
    if summary.not_accepted:
        fruitless = f", {len(summary.not_accepted)} without a calibration (mostly: too little turning)"
    output.say(
        f"{result.examined} of {counted(result.asked, 'recording')} examined{kept};"
        f" {counted(len(summary.errors), 'error')}{fruitless}."
    )
    for recording, sentence in summary.errors[:_SHOWN]:
        output.say(f"  {_short(recording)}: {sentence}")
    if summary.slowest and summary.slowest[0][1] >= LONG_S:
        output.say("Slowest: {} ({:.0f} s).".format(*summary.slowest[0]))
    for effect in [effect for effect in summary.effects if effect.largest_mgauss >= LEAST_MGAUSS][:_SHOWN]:
        output.say(
            f"  {effect.effect}: in {counted(effect.recordings, 'recording')} of"
            f" {counted(effect.vehicles, 'vehicle')}, median {effect.median_mgauss:.1f} mG,"
            f" largest {effect.largest_mgauss:.1f} mG"
        )
    for vehicle in summary.look_first[:_SHOWN]:
        where = f" ({vehicle.kind}; last: {_short(vehicle.last_recording)})" if vehicle.last_recording else ""
        output.say(f"Look at {vehicle.name}{where}: {'; '.join(vehicle.why)}.")
    output.say(f"Table: {out}")
    output.say(f"Summary: {page}")


def _document(result: FleetResult, summary: Summary, out: Path, page: Path) -> dict[str, object]:
    """Return the document of `--json`."""
    return {
        "schema": "mavcompass.fleet/1",
        "work": summary.work,
        "asked": result.asked,
        "examined": result.examined,
        "kept": result.kept,
        "recordings": summary.recordings,
        "table": out,
        "report": page,
        "errors": [{"recording": recording, "error": error} for recording, error in summary.errors],
        "not_accepted": [{"recording": recording, "why": why} for recording, why in summary.not_accepted],
        "slowest": [{"recording": recording, "seconds": seconds} for recording, seconds in summary.slowest],
        "effects": [asdict(effect) for effect in summary.effects],
        "vehicles": [_vehicle(vehicle) for vehicle in summary.vehicles],
        "odd": [asdict(odd) for odd in summary.population.odd] if summary.population is not None else [],
        "look_first": [vehicle.name for vehicle in summary.look_first],
    }


def _vehicle(vehicle: Vehicle) -> dict[str, object]:
    return {
        "name": vehicle.name,
        "kind": vehicle.kind,
        "recordings": vehicle.recordings,
        "errors": vehicle.errors,
        "not_accepted": vehicle.not_accepted,
        "effects_mgauss": dict(vehicle.effects),
        "why": list(vehicle.why),
        "compasses": [
            {
                "compass": history.compass,
                "device_id": history.device_id,
                "rate_deg_per_30_days": history.rate_deg_per_30_days,
                "history": [asdict(point) for point in history.points],
                "moves": [asdict(move) for move in history.moves],
            }
            for history in vehicle.histories
        ],
    }
