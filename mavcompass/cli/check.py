"""`mavcompass check SOURCE`: the pre-flight check, read in ten seconds."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from mavcompass.cli.options import Output, common_options
from mavcompass.cli.source import (
    effects_option,
    open_source,
    require_for,
    sign_key_option,
    system_option,
    this_year,
)
from mavcompass.cli.terminal.lines import mark, showing_progress
from mavcompass.installation.invocation import program
from mavcompass.vehicle.transport import Recording, parse_address

if TYPE_CHECKING:
    from mavcompass.procedure.check import CheckReport, CheckSettings
    from mavcompass.vehicle.link import Link

NOT_FIT = 5
_RANK = {"fail": 0, "warn": 1, "pass": 2}


@click.command()
@click.argument("source")
@click.option(
    "--turn",
    type=click.Choice(("auto", "vehicle", "hand", "none")),
    default="auto",
    show_default=True,
    help="Who turns it by 90 degrees (auto: itself where it is armed, else nobody; in a recording nobody).",
)
@click.option("--strict", is_flag=True, help="Count a warning as a failure in the exit code.")
@click.option(
    "--offer", is_flag=True, help="Offer the calibration where it is the remedy; asks on the terminal."
)
@click.option("--all", "everything", is_flag=True, help="List what passed, too.")
@system_option
@effects_option
@sign_key_option
@common_options
def command(
    source: str,
    turn: str,
    strict: bool,
    offer: bool,
    everything: bool,
    system: int | None,
    effects: tuple[str, ...],
    output: Output,
) -> int:
    """Check the compass before a flight: pass, warn or fail, with reasons and remedies.

    It looks at parameters, field, dip, agreement of the compasses, gyro and estimator at rest, and turns
    the vehicle once by 90 degrees where that is possible; of a recording it goes by all of it. It writes
    nothing. Exit code: 0 fit (or a warning), 5 not fit, 3 no vehicle, 7 stopped.

    \b
    mavcompass check sim:rover
    mavcompass check udpin:0.0.0.0:14550 --turn none --json check.json
    """
    from mavcompass.cli.terminal.show import showing
    from mavcompass.procedure.check import CheckSettings

    require_for(source, report=offer)
    address = parse_address(source)
    if turn == "auto" and isinstance(address, Recording):
        turn = "none"  # it has turned when it did, and obeys nobody
    settings = CheckSettings(turn=turn, system=system, year=this_year())  # type: ignore[arg-type]
    if isinstance(address, Recording):
        settings = _as_recorded(source, settings)
    with open_source(address, effects) as link:
        with showing(quiet=not sys.stderr.isatty()) as show:
            report = _check(link, source, settings, show)
        _say(report, source, output, everything)
        output.write_json({"source": source} | report.to_json())
        if offer and report.calibration_advised and sys.stdin.isatty():
            return _calibrate(link, source, report, system, output)
    passed = report.verdict == "pass" or (report.verdict == "warn" and not strict)
    return 0 if passed else NOT_FIT


def _as_recorded(source: str, settings: CheckSettings) -> CheckSettings:
    """Add what all of a recording shows of each compass: true headings, and how far off its own are."""
    from mavcompass.api import read_track
    from mavcompass.calibration import calibrate_compasses
    from mavcompass.errors import BadRecording, PoorCalibration
    from mavcompass.heading.evidence import heading_of_track

    try:
        track = read_track(source)
        headings = {i: heading_of_track(track, None, i).north for i in track.compasses}
    except BadRecording:
        return settings  # what can be checked of it is
    settings = replace(settings, north={i: seen for i, seen in headings.items() if seen is not None})
    try:
        with showing_progress(Path(source).name) as progress:
            progress("calibrating by all of it")
            return replace(settings, found=calibrate_compasses(track))
    except (BadRecording, PoorCalibration):
        return settings


def _check(link: Link, source: str, settings: CheckSettings, show: Any) -> CheckReport:
    from mavcompass.procedure.check import check
    from mavcompass.procedure.script import Machine
    from mavcompass.vehicle.dialects import make_dialect
    from mavcompass.vehicle.driver import run

    machine = Machine(lambda context: check(context, lambda make: make_dialect(make, source), settings))
    return run(machine, link, on_show=show)


def _say(report: CheckReport, source: str, output: Output, everything: bool) -> None:
    """Print the list, the worst first; what passed only counted, unless asked for."""
    shown = sorted(report.items, key=lambda item: _RANK[item.verdict])
    listed = [item for item in shown if item.verdict != "pass" or everything]
    for item, after in zip_longest(listed, listed[1:]):
        output.say(f"{mark(item.verdict)}  {item.text}")
        if item.remedy and not (after and after.remedy == item.remedy):  # once, below all that it mends
            output.say(f"      {item.remedy}")
    for remark in report.remarks:
        output.say(f"Note: {remark}")
    advice = f"Next: {program()} calibrate {shlex.quote(source)}" if report.calibration_advised else ""
    if advice and not report.turns_itself and not isinstance(parse_address(source), Recording):
        advice += " --motion hand (it cannot turn on the spot), or of its next flight's log"
    output.say(f"{mark(report.verdict)}  {report.summary()}")
    if advice:
        output.say(f"      {advice}")


def _calibrate(link: Link, source: str, checked: CheckReport, system: int | None, output: Output) -> int:
    """Offer the calibration and run it where the person says yes; its exit code is ours."""
    who = "The vehicle will turn." if checked.turns_itself else "You will turn it."
    if not click.confirm(f"Calibrate now? {who}", err=True):
        return NOT_FIT
    from mavcompass.cli.terminal.show import showing
    from mavcompass.procedure.settings import CalibrateSettings
    from mavcompass.report.calibration import write_report
    from mavcompass.vehicle.calibrating import calibrate_on

    motion: Literal["auto", "hand"] = "auto" if checked.turns_itself else "hand"
    settings = CalibrateSettings(instances=(), motion=motion, system=system, year=this_year())
    with showing() as show:
        report = calibrate_on(link, source, settings, on_show=show, on_ask=show.ask)
    path = Path(f"compass-{report.identity.kind}-{report.identity.system}.html")
    write_report(report, path)
    output.say(f"{'Written.' if report.written else 'Nothing written.'} Report: {path}")
    return 0 if report.written else NOT_FIT
