"""`mavcompass calibrate SOURCE`: turn, solve, write, prove; or solve a recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from mavcompass.cli.options import FILE, Grouped, Number, Output, Whole, common_options, report_option
from mavcompass.cli.source import (
    compass_option,
    effects_option,
    max_error_option,
    method_option,
    open_source,
    refuse_contradiction,
    refuse_unasked_write,
    require_for,
    sign_key_option,
    systems_option,
    this_year,
)
from mavcompass.errors import UsageError
from mavcompass.vehicle.transport import Recording, parse_address

if TYPE_CHECKING:
    from mavcompass.calibration.result import TrueHeading

_HELP = {
    "What is calibrated": (
        "flight.tlog --compass 1,2 --method ellipsoid",
        (
            "instances",
            "method",
            "true_heading_deg",
            "true_heading_sigma_deg",
            "max_error_deg",
            "orientation",
            "rewrite",
            "in_force_file",
        ),
    ),
    "How it turns": (
        "sim:copter --motion hand --positions 6",
        ("motion", "turn_by", "continuous", "positions", "step_deg", "dwell_s", "speak"),
    ),
    "What you allow": (
        "udpin:0.0.0.0:14550 --arm --set-mode --takeoff 3",
        ("yes", "dry_run", "set_mode", "arm", "takeoff_m", "land", "reboot"),
    ),
    "What you get": (
        "sim:rover --dry-run --report compass.html",
        ("report_file", "params_out", "output"),
    ),
    "The link": ("udpin:0.0.0.0:14550 --system 2", ("system", "sign_key", "effects")),
}


@click.command(cls=Grouped, groups=_HELP)
@click.argument("source")
@method_option
@click.option(
    "--true-heading",
    "true_heading_deg",
    type=Number(-360.0, 360.0),
    metavar="DEG",
    help="For one-point: where the vehicle points, from true north (a known line, a landmark's bearing, the"
    " sun's azimuth); without it a second antenna's.",
)
@click.option(
    "--true-heading-sigma",
    "true_heading_sigma_deg",
    type=Number(0.05, 45.0),
    metavar="DEG",
    help="How sure that is [default: 1, half a metre of hull laid along a line to a centimetre].",
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
    help="Turn by the pilot's own controls, in MANUAL (a quadplane: QLOITER), instead of by targets (auto).",
)
@click.option("--set-mode", is_flag=True, help="Allow changing the flight mode; it is put back afterwards.")
@click.option(
    "--arm",
    is_flag=True,
    help="Allow arming; it is disarmed afterwards. Where it refuses for its compass alone, you are asked (not"
    " with --yes) whether that one check may be set aside until it is armed.",
)
@click.option(
    "--takeoff",
    "takeoff_m",
    type=Number(2.0, 100.0),
    metavar="M",
    help="Allow a copter to take off to M metres; it lands afterwards.",
)
@click.option(
    "--land", is_flag=True, help="Allow landing a copter that flies; PX4 loads the values on the ground."
)
@compass_option
@click.option("--yes", is_flag=True, help="Write without asking.")
@click.option("--dry-run", is_flag=True, help="Never write.")
@click.option(
    "--positions",
    type=Whole(3, 24),
    default=4,
    show_default=True,
    help="Where it stands still; more are added while the heading is not sure enough.",
)
@click.option(
    "--step-deg",
    type=Number(-180.0, 180.0),
    default=90.0,
    show_default=True,
    help="Turn between positions; negative turns left.",
)
@click.option(
    "--dwell",
    "dwell_s",
    type=Number(0.5, 60.0),
    help="Seconds to stand still at each position; by default until the heading is sure enough.",
)
@max_error_option
@click.option(
    "--reboot",
    is_flag=True,
    help="Allow restarting the autopilot where its own heading cannot be brought right otherwise.",
)
@click.option(
    "--orientation", is_flag=True, help="Set how a compass is mounted, too, where it is mounted turned."
)
@click.option("--rewrite", is_flag=True, help="Write also where the values in force are already right.")
@click.option(
    "--continuous/--stops",
    "continuous",
    help="Pass through the positions in one turn, in half the time, or stop at each [default: stops].",
)
@click.option("--speak", is_flag=True, help="Say the prompts aloud (spd-say, espeak-ng or say).")
@systems_option
@effects_option
@click.option(
    "--in-force",
    "in_force_file",
    type=FILE,
    help="Parameters that were in force, for a recording without them.",
)
@click.option(
    "--params-out",
    type=FILE,
    help="Write the new values to a .param, .parm or .params file too.",
)
@report_option
@sign_key_option
@common_options
def command(
    source: str,
    method: str,
    true_heading_deg: float | None,
    true_heading_sigma_deg: float | None,
    motion: str,
    turn_by: str,
    set_mode: bool,
    arm: bool,
    takeoff_m: float | None,
    land: bool,
    instances: tuple[int, ...] | None,
    yes: bool,
    dry_run: bool,
    positions: int,
    step_deg: float,
    dwell_s: float | None,
    max_error_deg: float,
    reboot: bool,
    orientation: bool,
    rewrite: bool,
    continuous: bool,
    speak: bool,
    system: int | str | None,
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
    mavcompass calibrate sim:rover --method autopilot --dry-run
    """

    address = parse_address(source)
    if instances is None:  # who recorded need not have looked after more than the first
        instances = (1,) if isinstance(address, Recording) else ()
    refuse_contradiction(yes, dry_run)
    if params_out is not None:
        from mavcompass.vehicle.parameters.files import parameter_form

        parameter_form(params_out)  # a wrong suffix is told before the vehicle moves
    require_for(address, report=report_file)
    if continuous and (motion == "hand" or method not in ("auto", "four-positions")):
        raise UsageError(
            "--continuous is for a vehicle that turns itself, by four-positions.", "Leave it away."
        )
    if not isinstance(address, Recording):
        if in_force_file is not None:
            raise UsageError("--in-force is for recordings.", "A live vehicle tells its parameters itself.")
        refuse_unasked_write(yes, dry_run)
        method = "four-positions" if method == "auto" else method
    from mavcompass.cli.calibration import Results, calibrate_all, calibrate_vehicle, solve_recording
    from mavcompass.procedure.motion import Permissions
    from mavcompass.procedure.positions import DwellSettings
    from mavcompass.procedure.settings import CalibrateSettings

    writing: Literal["ask", "yes", "never"] = "yes" if yes else "never" if dry_run else "ask"
    settings = CalibrateSettings(
        instances=instances,
        method=method,
        true_heading=_given(method, motion, true_heading_deg, true_heading_sigma_deg),
        max_heading_error_deg=max_error_deg,
        motion=motion,  # type: ignore[arg-type]
        turn_by=turn_by,  # type: ignore[arg-type]
        permissions=Permissions(set_mode, arm, takeoff_m or 0.0, land, exempt=writing),
        positions=positions,
        step_rad=math.radians(step_deg),
        writing=writing,
        system=None if isinstance(system, str) else system,
        year=this_year(),
        reboot=reboot,
        orientation=orientation,
        rewrite=rewrite,
        continuous=continuous,
        dwell=DwellSettings() if dwell_s is None else DwellSettings(dwell_s=dwell_s, shortest_s=dwell_s),
    )
    results = Results(source, output, params_out, report_file)
    if isinstance(address, Recording):
        return solve_recording(results, settings, in_force_file)
    by_hand = motion == "hand" or method == "autopilot"
    with open_source(address, effects, turn_by != "auto", by_hand) as link:
        calibrate = calibrate_all if system == "all" else calibrate_vehicle
        return calibrate(link, results, settings, speak)


def _given(
    method: str, motion: str, heading_deg: float | None, sigma_deg: float | None
) -> TrueHeading | None:
    """Put the given heading together. Raises UsageError where these options contradict each other."""
    if method != "one-point" and (heading_deg, sigma_deg) != (None, None):
        raise UsageError("--true-heading is for --method one-point.", "Leave it away, or take that method.")
    if heading_deg is None and sigma_deg is not None:
        raise UsageError("--true-heading-sigma is of --true-heading.", "Give that, too.")
    if method == "one-point" and motion != "auto":
        raise UsageError("--method one-point leaves the vehicle where it stands.", "Leave --motion away.")
    if method == "autopilot" and motion == "vehicle":
        raise UsageError("--method autopilot wants a person who turns the vehicle.", "Leave --motion away.")
    if heading_deg is None:
        return None
    from mavcompass.calibration.result import true_heading

    return true_heading(math.radians(heading_deg), None if sigma_deg is None else math.radians(sigma_deg))
