"""`mavcompass calibrate SOURCE`: turn, solve, write, prove; or solve a recording."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcompass.calibration.methods import method_names
from mavcompass.cli.needs import require_for
from mavcompass.cli.options import Output, common_options
from mavcompass.cli.terminal.colour import styled
from mavcompass.errors import BadRecording, PoorCalibration, UsageError

if TYPE_CHECKING:
    from mavcompass.calibration.result import CalibrationResult
    from mavcompass.procedure.report import CalibrationReport
    from mavcompass.track import Track
    from mavcompass.vehicle.link import Link
    from mavcompass.vehicle.transport.address import Address

NOT_ACCEPTED = 5


def chosen_instances(context: click.Context, parameter: click.Parameter, value: str) -> tuple[int, ...]:
    if value == "all":
        return ()
    try:
        chosen = tuple(sorted({int(part) for part in value.split(",")}))
    except ValueError:
        chosen = ()
    if not chosen or any(i not in (1, 2, 3) for i in chosen):
        raise click.BadParameter("give numbers from 1 to 3, such as 1,2, or all.", context, parameter)
    return chosen


@click.command()
@click.argument("source")
@click.option(
    "--method",
    type=click.Choice(method_names()),
    default="four-positions",
    show_default=True,
    help="How the readings are solved.",
)
@click.option(
    "--motion",
    type=click.Choice(("auto", "vehicle", "hand")),
    default="auto",
    help="Who turns the vehicle (auto: itself where it is armed, else a person).",
)
@click.option(
    "--turn-by",
    type=click.Choice(("auto", "rc-override", "manual-control")),
    default="auto",
    help="Turn by the pilot's own controls, in MANUAL, instead of by targets (auto).",
)
@click.option("--set-mode", is_flag=True, help="Allow changing the flight mode; it is put back afterwards.")
@click.option("--arm", is_flag=True, help="Allow arming; it is disarmed afterwards.")
@click.option(
    "--takeoff",
    "takeoff_m",
    type=click.FloatRange(2.0, 100.0),
    metavar="M",
    help="Allow a copter to take off to M metres; it lands afterwards.",
)
@click.option(
    "--compass", "instances", default="1", callback=chosen_instances, help="1, 2, 3, a list of them, or all."
)
@click.option("--yes", is_flag=True, help="Write without asking.")
@click.option("--dry-run", is_flag=True, help="Never write.")
@click.option(
    "--positions",
    type=click.IntRange(3, 24),
    default=4,
    show_default=True,
    help="Where it stands still; more are added while the heading is not sure enough.",
)
@click.option(
    "--step-deg",
    type=click.FloatRange(-180.0, 180.0),
    default=90.0,
    show_default=True,
    help="Turn between positions; negative turns left.",
)
@click.option(
    "--dwell",
    "dwell_s",
    type=click.FloatRange(0.5, 60.0),
    default=1.7,
    show_default=True,
    help="Seconds to stand still at each position.",
)
@click.option(
    "--max-error-deg",
    type=click.FloatRange(0.1, 45.0),
    default=2.0,
    show_default=True,
    help="Accept no calibration with a larger predicted heading error.",
)
@click.option("--speak", is_flag=True, help="Say the prompts aloud (spd-say, espeak-ng or say).")
@click.option("--system", type=click.IntRange(1, 255), help="System id, where several vehicles are heard.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME[:p=v,..]",
    help="An effect for sim:... (see gap catalogue).",
)
@click.option(
    "--in-force",
    "in_force_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Parameters that were in force, for a recording without them.",
)
@click.option(
    "--params-out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the new values to a .param, .parm or .params file too.",
)
@click.option(
    "--report", "report_file", type=click.Path(dir_okay=False, path_type=Path), help="Write an HTML report."
)
@common_options
def command(
    source: str,
    method: str,
    motion: str,
    turn_by: str,
    set_mode: bool,
    arm: bool,
    takeoff_m: float | None,
    instances: tuple[int, ...],
    yes: bool,
    dry_run: bool,
    positions: int,
    step_deg: float,
    dwell_s: float,
    max_error_deg: float,
    speak: bool,
    system: int | None,
    effects: tuple[str, ...],
    in_force_file: Path | None,
    params_out: Path | None,
    report_file: Path | None,
    output: Output,
) -> int:
    """Calibrate the compass of a live vehicle, or solve a recording.

    A live vehicle turns in steps of 90 degrees (or is turned by hand); the result is judged by its
    heading error, written as a transaction with an undo file, and proven by one more turn.

    \b
    mavcompass calibrate sim:rover --yes
    mavcompass calibrate udpin:0.0.0.0:14550 --dry-run
    mavcompass calibrate flight.tlog --params-out compass.param
    """
    from mavcompass.vehicle.transport.address import Recording, parse_address

    if yes and dry_run:
        raise UsageError("--yes and --dry-run exclude each other.", "Give one of them.")
    if params_out is not None:
        from mavcompass.vehicle.parameters.files import parameter_form

        parameter_form(params_out)  # a wrong suffix is told before the vehicle moves
    address = parse_address(source)
    require_for(address, report=report_file)
    if isinstance(address, Recording):
        return _recording(
            source, method, instances, max_error_deg, in_force_file, params_out, report_file, output
        )
    if in_force_file is not None:
        raise UsageError("--in-force is for recordings.", "A live vehicle tells its parameters itself.")
    if not yes and not dry_run and not sys.stdin.isatty():
        raise UsageError(
            "Nobody can be asked whether to write: standard input is not a terminal.",
            "Give --yes to write without asking, or --dry-run to write nothing.",
        )
    import math

    from mavcompass.procedure.calibrate import CalibrateSettings
    from mavcompass.procedure.motion import Permissions
    from mavcompass.procedure.positions import DwellSettings

    settings = CalibrateSettings(
        instances=instances,
        motion=motion,  # type: ignore[arg-type]
        turn_by=turn_by,  # type: ignore[arg-type]
        permissions=Permissions(set_mode, arm, takeoff_m or 0.0),
        positions=positions,
        step_rad=math.radians(step_deg),
        writing="yes" if yes else "never" if dry_run else "ask",
        system=system,
        year=_this_year(),
        dwell=DwellSettings(dwell_s=dwell_s),
    )
    return _live(
        source, address, effects, method, max_error_deg, settings, speak, params_out, report_file, output
    )


def _this_year() -> float:
    import time

    from mavcompass.earth_field import decimal_year

    return round(decimal_year(time.time()), 2)


# --- a recording ---------------------------------------------------------------------------------


def _recording(
    source: str,
    method: str,
    instances: tuple[int, ...],
    max_error_deg: float,
    in_force_file: Path | None,
    params_out: Path | None,
    report_file: Path | None,
    output: Output,
) -> int:
    from mavcompass import api
    from mavcompass.calibration import Limits, calibrate_compasses
    from mavcompass.report.document import recording_document, refused_document

    track = api.read_track(source)
    if in_force_file is not None:
        from mavcompass.compass_parameters import with_parameters_in_force
        from mavcompass.vehicle.parameters.files import read_parameter_file

        track = with_parameters_in_force(track, read_parameter_file(in_force_file))
    missing = [i for i in instances if i not in track.compasses]
    if missing:
        raise BadRecording(
            f"{source} has no compass {missing[0]}; it has {', '.join(map(str, track.compasses)) or 'none'}.",
            "Choose with --compass.",
        )
    chosen = instances or tuple(track.compasses)
    try:
        found = calibrate_compasses(track, method, chosen, limits=Limits(heading_deg=max_error_deg))
    except PoorCalibration as error:
        output.write_json(refused_document(source, method, chosen, str(error), track))
        raise
    results = list(found.values())
    for note in track.notes:
        output.say(f"Note: {note}")
    for result in results:
        _say_result(output, result)
    document = recording_document(source, track, results, method)
    output.write_json(document)
    accepted = all(result.accepted for result in results)
    if accepted and params_out is not None:
        _require_known_correction(track, [result.instance for result in results])
        _write_params(params_out, document, source, output)
    if report_file is not None:
        from mavcompass.report.calibration import write_recording_report

        write_recording_report(track, results, report_file)
        output.say(f"Report: {report_file}")
    return 0 if accepted else NOT_ACCEPTED


def _require_known_correction(track: Track, instances: Sequence[int]) -> None:
    """Refuse to write parameters that would be relative to unknown ones.

    Only ArduPilot reports corrected fields; what PX4 and bare sensors record is raw.
    """
    unknown = [i for i in instances if not track.compasses[i].correction_known]
    if unknown and track.autopilot == "ardupilot":
        raise BadRecording(
            f"The recording does not tell which parameters were in force for compass {unknown[0]}, and"
            " ArduPilot's readings have them inside: the new values would be wrong by the old ones.",
            "Save the vehicle's parameters of that day to a file and give it with --in-force FILE.",
        )


# --- a live vehicle ------------------------------------------------------------------------------


def _live(
    source: str,
    address: Address,
    effects: tuple[str, ...],
    method: str,
    max_error_deg: float,
    settings: Any,
    speak: bool,
    params_out: Path | None,
    report_file: Path | None,
    output: Output,
) -> int:
    from mavcompass.cli.terminal.show import ask_on_terminal, showing
    from mavcompass.cli.terminal.speech import speaking
    from mavcompass.report.document import live_document, refused_document
    from mavcompass.vehicle.calibrating import calibrate_on

    with open_source(address, effects, as_ground_station=settings.turn_by != "auto") as link:
        before_deg = _true_error_deg(link, settings.instances)
        told_later = _told_later(output, settings.writing)
        with showing(told_later=told_later) as shown, speaking(shown, speak) as show:
            try:
                report = calibrate_on(
                    link, source, settings, method, max_error_deg, on_show=show, on_ask=ask_on_terminal
                )
            except PoorCalibration as error:
                output.write_json(refused_document(source, method, settings.instances or (1,), str(error)))
                raise
        after_deg = _true_error_deg(link, settings.instances)
    for result in report.results:
        _say_result(output, result)
    for message in report.messages:
        output.say(f"Note: {message}")
    if before_deg is not None and after_deg is not None:
        output.say(
            f"Heading error against the simulator's truth, rms over the circle:"
            f" {before_deg:.2f} deg before, {after_deg:.2f} deg after."
        )
    document = live_document(source, report, method)
    if before_deg is not None:
        document["true_heading_error_deg"] = {"before": before_deg, "after": after_deg}
    output.write_json(document)
    if report.accepted and params_out is not None:
        _write_params(params_out, document, source, output)
    if report_file is not None:
        from mavcompass.report.calibration import write_report

        write_report(report, report_file)
        output.say(f"Report: {report_file}")
    _say_outcome(output, report, source)
    return _exit_code(report)


def _told_later(output: Output, writing: str) -> tuple[str, ...]:
    """Name the steps whose outcome the same eyes see again, as the result: it is not shown twice.

    Who is asked whether to write sees what was found before the question.
    """
    if output.json_file == "-" or sys.stdout.isatty() != sys.stderr.isatty():
        return ()
    return ("prove",) if writing == "ask" else ("solve", "prove")


def open_source(address: Address, effects: Sequence[str], as_ground_station: bool = False) -> Link:
    """Open a live address; effects go to an embedded simulated vehicle only.

    The pilot's controls are taken from a ground station only (SYSID_MYGCS).
    """
    from mavcompass.vehicle.link import GROUND_STATION, ONBOARD_COMPUTER
    from mavcompass.vehicle.opening import open_link
    from mavcompass.vehicle.transport.address import Simulated

    if not effects:
        return open_link(address, GROUND_STATION if as_ground_station else ONBOARD_COMPUTER)
    if not isinstance(address, Simulated):
        raise UsageError("--effect is for sim:VEHICLE only.", "Leave it away for a real vehicle.")
    return open_link(Simulated(address.vehicle, address.seed, (*address.effects, *effects)))


def _true_error_deg(link: Link, instances: tuple[int, ...]) -> float | None:
    """Return the heading error that an embedded simulator knows, of the first compass calibrated."""
    autopilot = getattr(link, "autopilot", None)
    if autopilot is None:
        return None
    from mavcompass.simulation.heading_error import heading_error_rms_deg

    return heading_error_rms_deg(autopilot, instances[0] if instances else 1)


def _say_result(output: Output, result: CalibrationResult) -> None:
    from mavcompass.calibration.result import summary

    output.say(styled(summary(result), fg="green" if result.accepted else "red"))
    for reason in (*result.reasons, *result.warnings):
        output.say(f"  - {reason}")


def _write_params(path: Path, document: dict[str, object], source: str, output: Output) -> None:
    from mavcompass.vehicle.parameters.files import write_parameter_file

    values: dict[str, float] = {}
    compasses: Any = document["compasses"]
    for compass in compasses:
        values |= compass["parameters"]
    write_parameter_file(path, values, (f"Compass calibration from {source}, by mavcompass.",))
    output.say(f"Parameters: {path}")


def _say_outcome(output: Output, report: CalibrationReport, source: str) -> None:
    outcome = report.outcome
    if report.written and outcome is not None:
        output.say("Written and read back.")
        if report.proof is not None:
            output.say(report.proof.summary())
        if outcome.undo_file is not None:
            output.say(f"To undo: {outcome.restore_command}")
    elif report.undone:
        output.say("The old values are back on the vehicle.")
    else:
        output.say("Nothing was written.")


def _exit_code(report: CalibrationReport) -> int:
    if not report.accepted or report.undone:
        return NOT_ACCEPTED
    if report.plan is not None and report.plan.refusals:
        return NOT_ACCEPTED
    return 0
