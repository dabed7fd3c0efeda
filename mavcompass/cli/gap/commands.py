"""`mavcompass gap ...`: diagnosis, catalogue, export, rehearsal and the sealed examination."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.gap.shared import (
    baseline_option,
    compass_option,
    diagnosed,
    say_comparison,
    say_summary,
    write_report,
)
from mavcompass.cli.options import FILE, THERE, Commands, Output, Whole, common_options, report_option
from mavcompass.cli.source import reference_option, require_for
from mavcompass.cli.terminal.lines import bar, showing_progress
from mavcompass.errors import UsageError
from mavcompass.files import write_text
from mavcompass.installation.invocation import program

if TYPE_CHECKING:
    from mavcompass.gap.result import Diagnosis
    from mavcompass.gap.trial.cases import Generator, Tier


@click.group(cls=Commands)
def command() -> None:
    """Explain the gap between the simulation and a recording.

    \b
    Example: mavcompass gap diagnose flight.tlog --report gap.html
    """


@command.command()
@click.argument(
    "logs", metavar="LOG...", nargs=-1, required=True,
    type=THERE,
)  # fmt: skip
@compass_option
@baseline_option
@click.option("--thorough", is_flag=True, help="Compare more readings of a long recording; takes longer.")
@click.option("--withhold", multiple=True, metavar="EFFECT", help="Do not use this effect and its aliases.")
@reference_option
@report_option
@common_options
def diagnose(
    logs: tuple[Path, ...],
    instance: int,
    baseline: Path | None,
    thorough: bool,
    withhold: tuple[str, ...],
    reference: str,
    report_file: Path | None,
    output: Output,
) -> None:
    """Say where the gap lies, which effect causes it, and how far it shrinks with that effect.

    Several recordings of one vehicle also tell which causes are the vehicle's, and which of one flight.

    \b
    Example: mavcompass gap diagnose flight.tlog --baseline good.tlog --json gap.json
    """
    require_for(*logs, baseline, report=report_file)
    if report_file is not None and len(logs) > 1:
        raise UsageError("A report shows one recording.", "Name one recording, or leave --report out.")
    found = [diagnosed(log, instance, baseline, withhold, reference, thorough) for log in logs]
    for log, diagnosis in zip(logs, found, strict=True):
        if len(logs) > 1:
            output.say(f"{log}:")
        _say(diagnosis, output)
    diagnosis = found[0]
    if len(logs) > 1:
        from mavcompass.gap.answer.naming import together

        vehicle = together(found)
        for line in vehicle.lines():
            output.say(line)
        output.write_json(vehicle.to_json())
    else:
        output.write_json(diagnosis.to_json())
    if report_file is not None:
        from mavcompass.report.gap import write_gap_report

        write_gap_report(diagnosis, report_file)
        output.say(f"Report: {report_file}")


@command.command()
@click.argument("simulator", metavar="SIM", type=THERE)
@click.argument("vehicle", metavar="REAL", type=THERE)
@click.argument("again", metavar="[SIM2]...", nargs=-1, type=THERE)
@compass_option
@report_option
@common_options
def compare(
    simulator: Path,
    vehicle: Path,
    again: tuple[Path, ...],
    instance: int,
    report_file: Path | None,
    output: Output,
) -> None:
    """Say what a simulator's recording lacks beside the vehicle's, and the vehicle's beside it.

    SIM2, the simulator flown again with what `gap export REAL --baseline SIM` wrote, tells how much of the
    promised shrink was achieved. Trajectory, place and rates may differ.

    \b
    Example: mavcompass gap compare sitl.tlog flight.tlog sitl_again.tlog --report closed.html
    """
    require_for(simulator, vehicle, *again, report=report_file)
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
    write_report(comparison, report_file, output)


@command.command()
@common_options
def catalogue(output: Output) -> None:
    """List the physical effects, their parameters and what tells them apart.

    \b
    Example: mavcompass gap catalogue
    """
    from mavcompass.simulation.effects import catalogue as every

    for effect in every().values():
        output.say(f"{effect.id}: {effect.title}")
        shown = effect.parameters if len(effect.parameters) <= 9 else effect.parameters[:3]
        for p in shown:
            output.say(f"    {p.name} [{p.unit}] {p.low:g} .. {p.high:g}, typically {p.default:g}")
        if len(shown) < len(effect.parameters):
            output.say(f"    ... and {len(effect.parameters) - len(shown)} more of the same")
        if effect.needs:
            output.say(f"    needs: {', '.join(sorted(effect.needs))}")
        if effect.aliases:
            output.say(f"    can look like: {', '.join(effect.aliases)}")
        output.say(f"    told apart by: {effect.separated_by}")
    output.write_json({"schema": "mavcompass.effects/1", "effects": [_effect(e) for e in every().values()]})


def _effect(effect: object) -> dict[str, object]:
    from mavcompass.simulation.effects import Effect

    assert isinstance(effect, Effect)
    return {
        "id": effect.id,
        "title": effect.title,
        "stage": effect.stage.name.lower(),
        "kind": effect.kind,
        "sensors": list(effect.groups),
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "default": p.default}
            for p in effect.parameters
        ],
        "needs": sorted(effect.needs),
        "aliases": list(effect.aliases),
        "separated_by": effect.separated_by,
        "source": effect.source,
    }


@command.command()
@click.argument("log", type=THERE)
@click.option(
    "--to",
    "target",
    type=click.Choice(("ardupilot-lua", "ardupilot-sitl", "gazebo", "mavcompass", "px4-sitl")),
    required=True,
    help="Which simulator is to have it.",
)
@click.argument("file", type=FILE)
@compass_option
@baseline_option
@reference_option
@common_options
def export(
    log: Path,
    target: str,
    file: Path,
    instance: int,
    baseline: Path | None,
    reference: str,
    output: Output,
) -> None:
    """Write LOG's vehicle, its known iron and the effects found, to FILE for a simulator.

    What the simulator cannot hold is said in the file and here, with the heading error that stays.

    \b
    Example: mavcompass gap export flight.tlog --to ardupilot-sitl found.parm
    """
    from mavcompass.gap.export import TARGETS, found_in
    from mavcompass.report.gap_words import VERDICTS

    require_for(log, baseline)
    diagnosis = diagnosed(log, instance, baseline, (), reference)
    vehicle = found_in(diagnosis, log.name)
    exported = TARGETS[target](vehicle)
    promised = vehicle.promised(exported)
    write_text(file, exported.text, "The export")
    found = ", ".join(sorted(diagnosis.effects)) or "no effect"
    output.say(f"{file}: the vehicle's known iron and {found} ({VERDICTS[diagnosis.verdict]}).")
    for sentence in exported.lacking:
        output.say(f"Not in the simulator: {sentence}")
    if exported.left_out and vehicle.shrink > promised:
        share, whole = f"{100.0 * promised:.0f} %", f"{100.0 * vehicle.shrink:.0f} %"
        output.say(f"With what it holds {share} of the gap in the field closes, with all of it {whole}.")
    use = exported.use.replace("FILE", shlex.quote(str(file)))
    output.say(f"Use it: {use.replace('mavcompass calibrate', f'{program()} calibrate')}")
    output.write_json(
        {
            "schema": "mavcompass.gap-export/1",
            "to": target,
            "verdict": diagnosis.verdict,
            "effects": sorted(diagnosis.effects),
            "parameters": dict(exported.parameters),
            "lacking": list(exported.lacking),
            "promised": {"shrink": vehicle.shrink, "by_what_the_simulator_holds": promised},
        }
    )


@command.command("blind-trial")
@click.option("--cases", type=Whole(1, 100_000), default=40, show_default=True, help="How many.")
@click.option("--seed", type=Whole(0), default=1, show_default=True, help="Of the cases.")
@click.option(
    "--generator",
    type=click.Choice(("bench", "vehicles", "another")),
    default="bench",
    show_default=True,
    help="Who makes the cases: our simulator with an exact attitude, vehicles of another make in use, or"
    " another simulator in closed form.",
)
@click.option(
    "--tier",
    type=click.Choice(("none", "single", "pair", "withheld", "outside")),
    help="Cases of one kind only: nothing wrong, one effect, two, one that may not be named, one of no"
    " catalogue (of the vehicles alone).",
)
@report_option
@common_options
def blind_trial(
    cases: int, seed: int, generator: Generator, tier: Tier | None, report_file: Path | None, output: Output
) -> None:
    """Examine the diagnosis on sealed cases: labels are hashed before it runs and opened after.

    \b
    Example: mavcompass gap blind-trial --cases 40 --seed 7
    """
    require_for(report=report_file, also=("A blind trial",))
    from mavcompass.gap.trial import run_trial

    trial = run_trial(cases, seed, tier, generator=generator)
    for line in trial.lines():
        output.say(line)
    output.write_json(trial.to_json())
    if report_file is not None:
        from mavcompass.report.gap import write_trial_report

        write_trial_report(trial, report_file)
        output.say(f"Report: {report_file}")


def _say(diagnosis: Diagnosis, output: Output) -> None:
    from mavcompass.report.gap_words import summary

    colour = "green" if diagnosis.verdict == "no_gap" else "yellow"
    say_summary(summary(diagnosis, everything=output.verbose), output, colour)


@command.command()
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
    from mavcompass.report.gap import rehearsal_summary, write_rehearsal_report

    say_summary(rehearsal_summary(result), output)
    output.write_json(result.to_json())
    if report_file is not None:
        write_rehearsal_report(result, report_file)
        output.say(f"Report: {report_file}")
