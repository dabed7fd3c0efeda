"""The procedures that the service runs on its link, put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcompass.calibration.result import CalibrationResult
from mavcompass.errors import Refused
from mavcompass.procedure.calibrate import Services, calibrate
from mavcompass.procedure.check import CheckReport, CheckSettings
from mavcompass.procedure.check import check as check_script
from mavcompass.procedure.dialect import WriteOutcome
from mavcompass.procedure.learnt import write_learnt as write_learnt_script
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.positions import DwellSettings
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Machine, Script
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import VehicleIdentity, find_vehicle
from mavcompass.service.view import VehicleView
from mavcompass.service.work import clock
from mavcompass.service.work.tasks import CalibrationRequest, CheckRequest, Task
from mavcompass.service.work.worker import Worker
from mavcompass.service.work.worker import solve as solve_there
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.parameters.undo import cut_short, read_kept, undo_saver


@dataclass(frozen=True, slots=True)
class Acquaintance:
    """Hold what a vehicle tells at the first meeting: who it is, and its parameters."""

    vehicle: Nameplate
    parameters: dict[str, float]


def meet(identity: VehicleIdentity, source: str) -> Machine[Acquaintance]:
    """Build the procedure that reads a vehicle's unique id and its compass parameters."""

    def script(context: Context) -> Script[Acquaintance]:
        context.system, context.component = identity.system, identity.component
        dialect = make_dialect(identity.autopilot, source)
        parameters = yield from dialect.compass_parameters(context)
        return Acquaintance((yield from dialect.nameplate(context, parameters)), parameters)

    return Machine(script)


def calibration(
    task: Task,
    request: CalibrationRequest,
    source: str,
    system: int,
    year: float,
    rate_hz: float,
    worker: Worker,
    undo_folder: Path,
) -> Machine[CalibrationReport]:
    """Build a calibration whose solving is done by the worker; its results appear in the task."""
    worker.start()

    def solve(
        track: Any, instances: tuple[int, ...], windows: list[Any], earth: Any, settings: Any, found: Any
    ) -> tuple[CalibrationResult, ...]:
        task.results = worker.call(solve_there, track, instances, windows, earth, settings, found)
        return task.results

    services = Services(
        dialect_for=lambda make: make_dialect(make, source),
        save_undo=undo_saver(source, undo_folder, clock.now),
        solve=solve,
        cut_short=cut_short(undo_folder),
    )
    settings = CalibrateSettings(
        instances=request.compasses,
        method=request.method,
        true_heading=request.true_heading,
        max_heading_error_deg=request.max_error_deg,
        motion=request.motion,
        permissions=Permissions(
            request.set_mode, request.arm, request.takeoff_m or 0.0, request.land, exempt=request.writing
        ),
        positions=request.positions,
        writing=request.writing,
        system=system,
        rate_hz=rate_hz,
        year=year,
        orientation=request.orientation,
        rewrite=request.rewrite,
        dwell=DwellSettings(dwell_s=request.dwell_s),
    )
    return Machine(lambda context: calibrate(context, services, settings))


def write_learnt(
    request: CalibrationRequest,
    results: Sequence[CalibrationResult],
    source: str,
    identity: VehicleIdentity,
    year: float,
    rate_hz: float,
    undo_folder: Path,
) -> Machine[CalibrationReport]:
    """Build the procedure that writes what was learnt on the way. Raises Refused where that is nothing."""
    if not results:
        raise Refused(
            "Nothing was learnt yet that would lower the heading error in force by the margin.",
            "Drive or fly on through all headings, or calibrate by four positions.",
        )
    settings = CalibrateSettings(writing=request.writing, system=identity.system, rate_hz=rate_hz, year=year)
    save = undo_saver(source, undo_folder, clock.now)

    def script(context: Context) -> Script[CalibrationReport]:
        return write_learnt_script(context, lambda make: make_dialect(make, source), save, results, settings)

    return Machine(script)


def check(request: CheckRequest, source: str, view: VehicleView, rate_hz: float) -> Machine[CheckReport]:
    """Build a pre-flight check."""
    north = {i: compass.north for i, compass in view.compasses.items() if compass.north is not None}
    settings = CheckSettings(request.turn, view.identity.system, rate_hz, view.year, north=north)
    return Machine(lambda context: check_script(context, lambda make: make_dialect(make, source), settings))


def undo(undo_file: Path, source: str, system: int, undo_folder: Path) -> Machine[WriteOutcome]:
    """Build the procedure that puts back what an undo file holds, as a transaction of its own."""
    kept = read_kept(undo_file)

    def script(context: Context) -> Script[WriteOutcome]:
        context.show("connect", "Waiting for the vehicle's heartbeat.", 0.0)
        identity = yield from find_vehicle(context, system)
        dialect = make_dialect(identity.autopilot, source)
        parameters = yield from dialect.compass_parameters(context)
        kept.refuse_other((yield from dialect.claim(context, parameters)))
        others = yield from dialect.read_parameters(context, [n for n in kept.values if n not in parameters])
        plan = dialect.plan_values({**parameters, **others}, kept.values, checked=False)
        context.show("write", f"Putting back {len(plan.changes)} parameters.", 0.5)
        save = undo_saver(source, undo_folder, clock.now)
        return (yield from dialect.write(context, plan, save))

    return Machine(script)
