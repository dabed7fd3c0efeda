"""`mavcompass params`: show, compare, write, back up and restore compass parameters."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcompass.cli.options import FILE, Commands, Function, Output, common_options, gathered
from mavcompass.cli.source import refuse_unasked_write, require_for, sign_key_option, system_option
from mavcompass.errors import MavCompassError, NoMagnetometer, UsageError, WriteFailed
from mavcompass.printable import counted
from mavcompass.vehicle.transport import Recording, parse_address

if TYPE_CHECKING:
    from mavcompass.procedure.dialect import ParameterPlan
    from mavcompass.procedure.nameplate import Nameplate
    from mavcompass.procedure.script import Context, Script
    from mavcompass.vehicle.session import HeldParameters, WriteReport

SCHEMA = "mavcompass.params/1"


@dataclass(frozen=True, slots=True)
class Asked:
    """Hold what a write is asked."""

    yes: bool
    dry_run: bool
    other_vehicle: bool
    system: int | None


@click.group(cls=Commands)
def command() -> None:
    """Show, compare, write, back up or restore a vehicle's compass parameters.

    Writing is a transaction: an undo file first, every value read back, all undone on any failure.
    FILE is a .param (Mission Planner), .parm (MAVProxy) or .params (QGroundControl) file.

    \b
    mavcompass params show sim:rover
    mavcompass params backup udpin:0.0.0.0:14550 before.param
    mavcompass params write udpin:0.0.0.0:14550 compass.param --yes
    """


def _reading(function: Function) -> click.Command:
    """Make a command of a function of SOURCE, a vehicle or a recording."""
    return command.command()(click.argument("source")(system_option(sign_key_option(function))))


def _writing(function: Function) -> click.Command:
    """Make a command that writes; the function gets the argument `asked: Asked`."""
    yes = click.option("--yes", is_flag=True, help="Write without asking.")
    dry_run = click.option("--dry-run", is_flag=True, help="Show what would be written, and write nothing.")
    other = click.option(
        "--other-vehicle", is_flag=True, help="Write what was kept of another vehicle, or of an unknown one."
    )
    return _reading(yes(dry_run(other(common_options(gathered(Asked, "asked")(function))))))


@_reading
@common_options
def show(source: str, system: int | None, output: Output) -> None:
    """Show the compass parameters of a vehicle or a recording.

    \b
    Example: mavcompass params show sim:rover
    """
    from mavcompass.parameter_remarks import remarks_said

    require_for(source)
    held = _read(source, system)
    _show_parameters(output, held)
    remarks = remarks_said(held.dialect.autopilot, held.values, *held.compasses)
    for remark in remarks:
        click.echo(f"Note: {remark}", err=True)
    shown = {"parameters": held.compass_values, "remarks": remarks}
    output.write_json({**_head("show", source, held), **shown})


@_reading
@click.argument("file", type=FILE)
@common_options
def diff(source: str, file: Path, system: int | None, output: Output) -> None:
    """Compare a vehicle's or a recording's compass parameters with a file.

    \b
    Example: mavcompass params diff udpin:0.0.0.0:14550 compass.param
    """
    from mavcompass.vehicle.parameters.undo import read_kept
    from mavcompass.vehicle.parameters.values import same_value
    from mavcompass.vehicle.session import compass_part

    require_for(source)
    kept = read_kept(file)  # what is wrong with it is told before the vehicle is asked
    held = _read(source, system)
    differing = {
        name: (held.values.get(name), value)
        for name, value in compass_part(kept, held).items()
        if name not in held.values or not same_value(held.values[name], value)
    }
    cells = [
        (n, "absent" if old is None else _number(old), _number(new)) for n, (old, new) in differing.items()
    ]
    _rows(output, ["parameter", "vehicle", "file"], cells, "{:<16} vehicle {}, file {}")
    if not differing:
        output.say(f"The vehicle holds the values of {file}.")
    rows = [{"name": n, "vehicle": old, "file": new} for n, (old, new) in differing.items()]
    output.write_json({**_head("diff", source, held), "file": str(file), "differing": rows})


@_writing
@click.argument("file", type=FILE)
def write(source: str, file: Path, asked: Asked, output: Output) -> None:
    """Write the compass parameters of a file to a vehicle; others in the file are left out.

    \b
    Example: mavcompass params write udpin:0.0.0.0:14550 compass.param
    """
    _write("write", source, file, asked, output)


@_writing
@click.argument("file", type=FILE, required=False)
def restore(source: str, file: Path | None, asked: Asked, output: Output) -> None:
    """Put back what an undo file or a backup holds (default: the last undo file of this vehicle).

    \b
    Example: mavcompass params restore udpin:0.0.0.0:14550
    """
    _write("restore", source, file, asked, output)


def _last_of(vehicle: Nameplate) -> Path:
    from mavcompass.vehicle.parameters.undo import newest_record, undo_directory

    folder = undo_directory()
    if (newest := newest_record(vehicle, folder)) is not None:
        return newest
    unmarked = newest_record(None, folder)
    what = f"There is no undo file of this vehicle ({vehicle}) in {folder}."
    if unmarked is None:
        raise UsageError(what, "Give the file to restore.")
    raise UsageError(
        f"{what} The newest of an earlier mavcompass, which did not note whose it was, is {unmarked}.",
        "Where it is this vehicle's, give it as FILE, with --other-vehicle.",
    )


@command.command()
@click.argument("source")
@click.argument("file", type=FILE, required=False)
@click.option("--yes", is_flag=True, help="Replace FILE where it exists.")
@system_option
@sign_key_option
@common_options
def backup(source: str, file: Path | None, yes: bool, system: int | None, output: Output) -> None:
    """Save a vehicle's or a recording's compass parameters in FILE (default: standard output).

    \b
    Example: mavcompass params backup udpin:0.0.0.0:14550 compass.param
    """
    from mavcompass.vehicle.parameters.files import parameter_form, parameter_text, write_parameter_file
    from mavcompass.vehicle.parameters.undo import marked

    require_for(source)
    if file is not None:
        parameter_form(file)  # a wrong suffix is told before the vehicle is asked
        if file.exists() and not yes:
            raise UsageError(f"{file} exists.", "Give another name, or --yes to replace it.")
    held = _read(source, system)
    values = held.compass_values
    comment = marked(held.vehicle, f"Compass parameters of {source}, by mavcompass.")
    if file is None:
        output.say(*parameter_text(values, "param", comment).splitlines())
    else:
        types = {name: parameter.type for name, parameter in held.compass_typed.items()}
        write_parameter_file(file, values, comment, types)
        output.say(f"{counted(len(values), 'parameter')} saved in {file}.")
    saved = {"file": None if file is None else str(file), "parameters": values}
    output.write_json({**_head("backup", source, held), **saved})


def _head(action: str, source: str, held: HeldParameters) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "action": action,
        "source": source,
        "autopilot": held.dialect.autopilot,
        "system": held.system,
        "compasses": held.compasses,
    }


def _read(source: str, system: int | None) -> HeldParameters:
    """Read what a vehicle or a recording holds."""
    from mavcompass.vehicle.session import read_vehicle, recorded_parameters

    if isinstance(parse_address(source), Recording):
        from mavcompass import read_track

        try:
            track = read_track(source)
        except NoMagnetometer as lacking:  # its parameters may be there all the same
            return recorded_parameters(lacking.parameters, source)
        return recorded_parameters(track.parameters, source, tuple(track.compasses))
    held: HeldParameters = _run(source, lambda context: read_vehicle(context, source, system))
    return held


def _run(source: str, script: Callable[[Context], Script[Any]]) -> Any:
    from mavcompass.cli.terminal.show import PlainShow, ask_on_terminal
    from mavcompass.procedure.script import Machine
    from mavcompass.vehicle import open_link
    from mavcompass.vehicle.driver import run

    with open_link(source) as link:
        return run(Machine(script), link, on_show=PlainShow(), on_ask=ask_on_terminal)


def _write(action: str, source: str, file: Path | None, asked: Asked, output: Output) -> None:
    """Write what a file holds; without one, what the vehicle's last undo file holds."""
    from mavcompass.vehicle.parameters.undo import read_kept, undo_saver
    from mavcompass.vehicle.session import compass_part, write_values

    if isinstance(parse_address(source), Recording):
        raise UsageError(f"{source} is a recording, which cannot be written to.", "Give a vehicle's address.")
    refuse_unasked_write(asked.yes, asked.dry_run)
    require_for(source)
    named = None if file is None else read_kept(file)  # what is wrong with it is told first
    document: dict[str, object] = {"schema": SCHEMA, "action": action, "source": source, "file": file}

    def wanted(held: HeldParameters, vehicle: Nameplate) -> Mapping[str, float]:
        kept = named or read_kept(_last_of(vehicle))
        document["file"] = kept.path
        if not asked.other_vehicle:
            kept.refuse_other(vehicle)
        return compass_part(kept, held)

    def consent(held: HeldParameters, plan: ParameterPlan) -> str | None:
        document.update(_head(action, source, held), **_plan_part(plan))
        _say_plan(output, held, plan)
        if asked.dry_run or asked.yes:
            return None if asked.dry_run else ""
        if not plan.changes:
            return "The vehicle holds these values. Have it load them, in case it does not go by them yet?"
        return f"Write {counted(len(plan.changes), 'parameter')}?"

    def script(context: Context) -> Script[WriteReport]:
        return write_values(
            context,
            source,
            wanted,
            undo_saver(source),
            checked=action == "write",
            consent=consent,
            system=asked.system,
        )

    try:
        report: WriteReport = _run(source, script)
    except MavCompassError as error:
        left = {"restore_command": error.restore_command} if isinstance(error, WriteFailed) else {}
        output.write_json({**document, "written": False, "verified": False, "error": str(error), **left})
        raise
    _say_outcome(output, report, asked.dry_run)
    outcome = report.outcome
    document["remarks"] = [*report.plan.remarks, *(outcome.remarks if outcome else ())]
    document |= {"written": outcome is not None, "verified": outcome is not None and outcome.verified}
    document["undo_file"] = outcome.undo_file if outcome else None
    output.write_json(document)


def _plan_part(plan: ParameterPlan) -> dict[str, object]:
    return {
        "changes": [{"name": c.name, "old": c.old, "new": c.new} for c in plan.changes],
        "refusals": plan.refusals,
        "remarks": plan.remarks,
    }


def _say_plan(output: Output, held: HeldParameters, plan: ParameterPlan) -> None:
    if plan.changes:
        cells = [(c.name, _number(c.old), _number(c.new)) for c in plan.changes]
        _rows(output, ["parameter", "old", "new"], cells, "{:<16} {} -> {}")
        if held.armed:
            then = "its heading will change while it is in use"
            if held.dialect.loads_disarmed:
                then = "it loads this on the ground only, and may store its own over it: write it again then"
            output.say(f"Note: the vehicle is armed; {then}.")
    for remark in plan.remarks:
        output.say(f"Note: {remark}")


def _say_outcome(output: Output, report: WriteReport, dry_run: bool) -> None:
    outcome = report.outcome
    if outcome is None:
        for refusal in report.plan.refusals:
            output.say(f"It would be refused: {refusal}")
        held = "The vehicle already holds these values; nothing was written."
        if report.loaded:
            held = f"The vehicle already held these values; it goes by them now, by {report.loaded}."
        output.say("Nothing written (--dry-run)." if dry_run and report.plan.changes else held)
        return
    for remark in outcome.remarks:
        output.say(f"Note: {remark}")
    output.say(f"{counted(len(outcome.values), 'parameter')} written and read back.")
    if report.loaded:
        output.say(f"The vehicle goes by them now, by {report.loaded}.")
    if outcome.undo_file is not None:
        output.say(f"To undo: {outcome.restore_command}")


# --- tables on a terminal, plain lines in a pipe --------------------------------------------------


def _show_parameters(output: Output, held: HeldParameters) -> None:
    """Show all parameters: on a terminal one column per compass, in a pipe one NAME VALUE per line."""
    if not _is_table_wanted(output):
        for name, value in held.compass_values.items():
            output.say(f"{name:<16} {_number(value)}")
        return
    compasses = held.compasses
    shared = [(name, _number(v)) for name, v in held.compass_values.items() if held.instance_of(name) is None]
    rows: dict[str, dict[int, str]] = {}
    for name, value in held.compass_values.items():
        instance = held.instance_of(name)
        if instance in compasses:
            rows.setdefault(_quantity(name, instance), {})[instance] = _number(value)
    _table(
        ["", *(f"compass {i}" for i in compasses)],
        [[quantity, *(cells.get(i, "") for i in compasses)] for quantity, cells in rows.items()],
    )
    _table(["of all compasses", "value"], shared)


def _rows(output: Output, head: Sequence[str], cells: Sequence[Sequence[str]], line: str) -> None:
    """Show cells below their head on a terminal, and as `line` has them in a pipe."""
    if _is_table_wanted(output):
        _table(head, cells)
        return
    for row in cells:
        output.say(line.format(*row))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(*head, box=box.SIMPLE_HEAD)
    for column in table.columns[1:]:
        column.justify = "right"
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _is_table_wanted(output: Output) -> bool:
    return sys.stdout.isatty() and output.json_file != "-"


def _quantity(name: str, instance: int | None) -> str:
    """Take the compass's number out of a name, so that all compasses share a row."""
    if name.startswith("CAL_MAG"):
        return name[len("CAL_MAG0_") :]
    stem = name.removeprefix(f"COMPASS{instance}_").removeprefix("COMPASS_")
    stem = stem.replace(f"{instance}_", "_").removesuffix(str(instance))
    return {"EXTERN": "EXTERNAL"}.get(stem, stem)


def _number(value: float) -> str:
    from mavcompass.vehicle.parameters.files import format_value

    return format_value(value) if value == value and abs(value) != float("inf") else str(value)
