"""Read, write and restore the parameters of a simulated vehicle, driven as in life."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mavcompass.procedure.dialect import ParameterPlan
from mavcompass.procedure.script import Context, Machine, Script
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import ONBOARD_COMPUTER
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters.undo import load_record, undo_saver
from mavcompass.vehicle.session import HeldParameters, WriteReport, read_vehicle, write_values

T = TypeVar("T")
SOURCE = "udpin:0.0.0.0:14550"


def read(autopilot: SimulatedAutopilot, faults: Faults | None = None, seed: int = 0) -> HeldParameters:
    return run(Machine(lambda context: read_vehicle(context, SOURCE)), link(autopilot, faults, seed))


def link(autopilot: SimulatedAutopilot, faults: Faults | None, seed: int) -> FaultyLink:
    return FaultyLink(SimulatedLink(autopilot, SOURCE, ONBOARD_COMPUTER), faults or Faults(), seed)


def write(
    autopilot: SimulatedAutopilot,
    held: HeldParameters,
    plan: ParameterPlan,
    folder: Path,
    faults: Faults | None = None,
    seed: int = 0,
) -> WriteReport:
    assert plan.changes and not plan.refusals

    def script(context: Context) -> Script[WriteReport]:
        saver = undo_saver(SOURCE, folder)
        outcome = yield from held.dialect.write(context, plan, saver)
        return WriteReport(held, plan, outcome)

    return run_on(autopilot, script, faults, seed)


def run_on(
    autopilot: SimulatedAutopilot,
    script: Callable[[Context], Script[T]],
    faults: Faults | None = None,
    seed: int = 0,
) -> T:
    """Run a script that knows its vehicle."""

    def addressed(context: Context) -> Script[T]:
        context.system, context.component = autopilot.board.system, 1
        return (yield from script(context))

    return run(Machine(addressed), link(autopilot, faults, seed))


def restore(autopilot: SimulatedAutopilot, undo_file: Path, folder: Path) -> None:
    def script(context: Context) -> Script[WriteReport]:
        return write_values(
            context,
            SOURCE,
            lambda held, vehicle: load_record(undo_file).before,
            undo_saver(SOURCE, folder),
            checked=False,
            consent=lambda held, plan: "",
        )

    run(Machine(script), link(autopilot, None, 0))
