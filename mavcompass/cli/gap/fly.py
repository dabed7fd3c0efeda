"""`mavcompass gap fly`: put what was found into a simulator at hand, fly it, see how far the gap closed."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavcompass.cli.gap.shared import (
    baseline_option,
    diagnosed,
    say_comparison,
    write_report,
)
from mavcompass.cli.options import THERE, Number, Output, common_options, report_option
from mavcompass.cli.source import require_for
from mavcompass.cli.terminal.lines import showing_progress
from mavcompass.errors import UsageError
from mavcompass.files import read_text

if TYPE_CHECKING:
    from mavcompass.gap.comparison import Comparison
    from mavcompass.gap.export import Exported
    from mavcompass.procedure.flying import Profile
    from mavcompass.vehicle.simulators import ArduPilotSitl, Px4Sih

PLAIN, AGAIN, EXPORT = "simulator.tlog", "simulator_again.tlog", "found.parm"
SCHEMA = "mavcompass.gap-fly/1"


@click.command()
@click.argument("log", type=THERE)
@click.option(
    "--sitl",
    "program",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PROGRAM",
    help="ArduPilot's simulator of this kind of vehicle (ardurover, arducopter), or PX4's (px4).",
)
@click.option(
    "--simulator",
    "plain",
    type=THERE,
    metavar="SIM",
    help="A recording of this simulator as it is; without it, it is flown twice.",
)
@baseline_option
@click.option(
    "--export",
    "given",
    type=THERE,
    metavar="FILE",
    help="Put in what `gap export` wrote for this simulator, instead of what is found.",
)
@click.option(
    "--defaults",
    multiple=True,
    type=THERE,
    metavar="FILE",
    help="Parameters of your simulator (.parm); may be repeated.",
)
@click.option("--model", default="", metavar="NAME", help="Its --model (default: what the motion needs).")
@click.option(
    "--seconds",
    type=Number(10.0),
    default=600.0,
    show_default=True,
    help="Fly at most so much of the recording.",
)
@click.option("--speed", type=Number(0.1, 100.0), help="2 is twice real time (default: 8; PX4: 4).")
@click.option(
    "--keep",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Keep the flights and the export there.",
)
@report_option
@common_options
def fly(
    log: Path,
    program: Path,
    plain: Path | None,
    baseline: Path | None,
    given: Path | None,
    defaults: tuple[Path, ...],
    model: str,
    seconds: float,
    speed: float | None,
    keep: Path | None,
    report_file: Path | None,
    output: Output,
) -> None:
    """Fly LOG's motion in a simulator at hand, without and with what was found, and compare.

    The simulator is started on this computer alone, flown by itself, recorded and stopped. It is flown with
    the iron that LOG's calibration cures, and again with what it then lacks beside LOG (with --baseline: with
    what LOG has beside that, with --export: with the parameters of FILE).

    \b
    Example: mavcompass gap fly flight.tlog --sitl build/sitl/bin/arducopter --keep flown --report closed.html
    """
    require_for(log, plain, baseline, report=report_file)
    from mavcompass.gap.comparison import compare, flown_again
    from mavcompass.gap.export import TARGETS, Exported, Found, found_in, nominal_settings
    from mavcompass.logs import read_track
    from mavcompass.procedure.flying import profile_of
    from mavcompass.vehicle.parameters.files import read_parameter_file
    from mavcompass.vehicle.simulators import simulator_of

    simulator = simulator_of(program, model, defaults, speed)
    with _folder(keep) as folder, showing_progress(log.name) as progress:
        vehicle = read_track(log)
        profile = profile_of(vehicle, longest_s=seconds)
        export = TARGETS[simulator.target]
        cure = simulator.calibration_in(vehicle.parameters)
        iron = export(Found(nominal_settings(vehicle))).parameters
        simulator = replace(simulator, known=cure | dict(iron))
        if plain is None:
            plain = _flown(simulator, profile, {}, folder / PLAIN, "as it is", progress)
        before = read_track(plain)
        comparison = compare(before, vehicle, progress=progress)
        if given is not None:
            exported = Exported(read_text(given), "", read_parameter_file(given))
        else:
            source = comparison.vehicle
            if baseline is not None:
                source = diagnosed(log, 1, baseline, (), "auto")
            found = found_in(source, log.name, beside_simulator=baseline is None)
            exported = export(found)
            comparison = replace(comparison, held=found.promised(exported) if source.causes else None)
        if exported.parameters and (given is not None or comparison.held is not None):
            (folder / EXPORT).write_text(exported.text, encoding="utf-8")
            parameters = cure | dict(exported.parameters)
            again = _flown(simulator, profile, parameters, folder / AGAIN, "with what was found", progress)
            comparison = flown_again(comparison, before, vehicle, [read_track(again)], progress)
    _say(comparison, exported, keep, output)
    output.write_json(_document(simulator, profile, comparison, exported, keep))
    write_report(comparison, report_file, output)


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    """Give the folder to keep, or one that is gone afterwards."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="mavcompass-") as name:
            yield Path(name)
        return
    try:
        keep.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"{keep} could not be made ({error.strerror}).", "Name a folder that you may write to."
        ) from error
    yield keep


def _flown(
    simulator: ArduPilotSitl | Px4Sih,
    profile: Profile,
    parameters: Mapping[str, float],
    tlog: Path,
    how: str,
    progress: Callable[[str], None],
) -> Path:
    """Fly the simulator once, in a folder of its own, and return the recording."""
    from mavcompass.logs import TlogWriter
    from mavcompass.vehicle.flying import fly_in_simulator

    with tempfile.TemporaryDirectory(prefix="mavcompass-") as folder, TlogWriter(tlog) as writer:
        fly_in_simulator(
            simulator, profile, parameters, Path(folder), writer.append,
            lambda show: progress(f"the simulator {how}: {show.text}"),
        )  # fmt: skip
    return tlog


def _say(comparison: Comparison, exported: Exported, keep: Path | None, output: Output) -> None:
    say_comparison(comparison, output)
    if not comparison.achieved:
        output.say("  nothing was found that can be put into the simulator; it was not flown again")
    for sentence in exported.lacking:
        output.say(f"  not in the simulator: {sentence}")
    if keep is not None:
        output.say(f"  kept in {keep}: {', '.join(sorted(path.name for path in keep.iterdir()))}")


def _document(
    simulator: ArduPilotSitl | Px4Sih,
    profile: Profile,
    comparison: Comparison,
    exported: Exported,
    keep: Path | None,
) -> dict[str, object]:
    compared = comparison.to_json()
    return {
        "schema": SCHEMA,
        "program": simulator.program,
        "to": simulator.target,
        "seconds_flown": profile.duration_s,
        "export": {"parameters": dict(exported.parameters), "lacking": list(exported.lacking)},
        "promised": compared["promised"],
        "achieved": compared["achieved"],
        "comparison": compared,
        "kept": keep,
    }
