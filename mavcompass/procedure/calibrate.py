"""The calibration: four positions, a solution, a verdict, a verified write, a proof.

Read `calibrate` from top to bottom: it is the product. It runs as a `Machine` (see `script`), so it
neither sleeps nor reads a clock nor touches a socket or a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.summary import summary
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import LinkError, LinkLost, Refused, WriteFailed
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.dialect import Dialect, ParameterPlan, SaveUndo, WriteOutcome, describe_compasses
from mavcompass.procedure.motion import Mobility, Motion, Permissions, SafetyLimits, Wishes
from mavcompass.procedure.positions import (
    DwellSettings,
    HandMover,
    Mover,
    Proof,
    Rest,
    Window,
    dwell,
    prove,
    visit,
)
from mavcompass.procedure.script import Context, Script, ask
from mavcompass.procedure.turning import GyroAngle, TurnBy
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState, find_vehicle
from mavcompass.track import Track
from mavcompass.track_builder import TrackBuilder

# Two thirds of a step prove as much as a whole one and take less of the vehicle's time.
_PROOF_SHARE = 2.0 / 3.0
_PLACELESS = "The vehicle does not know its place: nothing was taken from the world's magnetic model."
# Silent for so long after a stop, the vehicle was not stopped but lost.
_LOST_S = 2.5

Writing = Literal["ask", "yes", "never"]

# Solves one compass of a Track from the still stretches that the procedure chose.
Solve = Callable[[Track, int, list[Window], EarthField | None], CalibrationResult]


@dataclass(frozen=True, slots=True)
class CalibrateSettings:
    """Hold what the person may choose.

    Attributes:
        instances: compasses to calibrate, from 1; empty means all that the vehicle has.
        motion: who turns the vehicle; "auto" lets it turn itself where it is armed.
        turn_by: "auto" by targets; else by the pilot's own controls, in a mode in which they steer.
        permissions: what may be done to the vehicle so that it can turn itself.
        positions, step_rad: how many still positions, and the turn between them (negative: left).
        enough_deg, most_positions: a vehicle that turns itself visits more positions, up to so many,
            while the predicted heading error is larger.
        writing: "ask" the person, "yes" without asking, "never".
        system: MAVLink system id, where several vehicles share the link.
        rate_hz: at which IMU messages are asked for.
        year: decimal year to use where the vehicle does not know the date.
    """

    instances: tuple[int, ...] = (1,)
    motion: Motion = "auto"
    turn_by: TurnBy = "auto"
    permissions: Permissions = field(default_factory=Permissions)
    positions: int = 4
    step_rad: float = math.pi / 2.0
    enough_deg: float = 0.3
    most_positions: int = 8
    writing: Writing = "ask"
    system: int | None = None
    rate_hz: float = 25.0
    year: float = 2026.0
    dwell: DwellSettings = field(default_factory=DwellSettings)
    limits: SafetyLimits = field(default_factory=SafetyLimits)


@dataclass(frozen=True, slots=True)
class Services:
    """Hold what the procedure needs from rooms that it may not import."""

    dialect_for: Callable[[str], Dialect]
    save_undo: SaveUndo
    solve: Solve


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """Say what a calibration found and did.

    Attributes:
        before: the correction in force at the start, per compass.
        proof: what the turn after the write showed; None where nothing was written.
        undone: True where the proof failed and the old values were put back.
    """

    identity: VehicleIdentity
    results: tuple[CalibrationResult, ...]
    before: Mapping[int, FieldCorrection]
    track: Track
    windows: tuple[Window, ...]
    duration_s: float
    plan: ParameterPlan | None = None
    outcome: WriteOutcome | None = None
    proof: Proof | None = None
    undone: bool = False
    messages: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Tell whether every compass got a calibration worth writing."""
        return bool(self.results) and all(result.accepted for result in self.results)

    @property
    def written(self) -> bool:
        """Tell whether the new values are in force on the vehicle."""
        return self.outcome is not None and not self.undone


def calibrate(context: Context, services: Services, settings: CalibrateSettings) -> Script[CalibrationReport]:
    """Calibrate a live vehicle's compasses.

    Raises Refused where the vehicle must not be turned or was stopped, LinkError where it cannot be
    heard, WriteFailed where values were left half written, PoorCalibration where no solution exists.
    A solution that is not good enough is in the report, not accepted, and nothing is written.
    """
    desk = yield from _Desk.open(context, services, settings)
    try:
        return (yield from _calibrate(context, desk, settings))
    except Refused as why:
        if context.now - desk.state.heard_s > _LOST_S:
            remedy = "Bring the link back (power, cable, radio), then run again."
            raise LinkLost(why.what, remedy) from why
        raise


def _calibrate(context: Context, desk: _Desk, settings: CalibrateSettings) -> Script[CalibrationReport]:
    """Do the work, and put everything back however it ends."""
    rates = MessageRates()
    mobility = desk.mobility()
    finished = False
    try:
        yield from rates.ask(context, _wanted_rates(desk.identity, desk.instances, settings.rate_hz))
        mover = yield from mobility.take_charge(context, desk.parameters)
        report = desk.solve((yield from desk.visit(mover)))
        while desk.wants_more(report, mover):
            report = desk.solve((yield from desk.visit(mover, report.windows)))
        for result in report.results:
            context.show("solve", summary(result), settings.positions / (settings.positions + 1.0))
        mover.halt(context)  # nothing is asked of the vehicle while values are written
        if report.accepted and settings.writing != "never":
            report = yield from desk.write(report)
            if report.outcome is not None:
                report = yield from desk.prove_or_undo(report, mover)
        finished = True
        return report
    finally:
        yield from _put_back(context, mobility, rates, in_a_hurry=not finished)


def _put_back(context: Context, mobility: Mobility, rates: MessageRates, in_a_hurry: bool) -> Script[None]:
    """Give the vehicle back; a stop that comes now finds nothing moving and is no reason to leave it."""
    for _ in range(2):
        try:
            yield from mobility.end(context, in_a_hurry)
            yield from rates.restore(context)
            return
        except Refused:
            in_a_hurry = True


def _wanted_rates(
    identity: VehicleIdentity, instances: tuple[int, ...], rate_hz: float
) -> dict[type[mav.Message], float]:
    """List the messages to ask for: fast ones for the calibration, slow ones for safety."""
    px4 = identity.autopilot == "px4"
    kinds: dict[int, type[mav.Message]] = {
        1: mav.ScaledImu if px4 else mav.RawImu,
        2: mav.ScaledImu2,
        3: mav.ScaledImu3,
    }
    # The first compass's message brings the gyro along, so it is wanted in any case.
    wanted = {kinds[i]: rate_hz for i in sorted({1, *instances}) if i in kinds}
    wanted[mav.Attitude] = min(rate_hz, 10.0)
    # The mode and the arming are told by heartbeats only: one a second is late for ending a motion.
    wanted |= dict.fromkeys((mav.GlobalPositionInt, mav.RcChannels, mav.SysStatus, mav.Heartbeat), 4.0)
    wanted |= dict.fromkeys((mav.EkfStatusReport, mav.SystemTime), 2.0)
    if identity.kind == "copter":
        # What hovers sways and shakes: its tilt is told by the receiver's velocity and by as many readings
        # as there are, see `calibration.observation.sway`.
        wanted[mav.GpsRawInt] = 5.0
        wanted[kinds[1]] = 2.0 * rate_hz
    if px4:
        del wanted[mav.EkfStatusReport]
    return wanted


@dataclass(slots=True)
class _Desk:
    """Hold what one calibration works with."""

    context: Context
    services: Services
    settings: CalibrateSettings
    identity: VehicleIdentity
    dialect: Dialect
    parameters: dict[str, float]
    instances: tuple[int, ...]
    state: VehicleState
    builder: TrackBuilder
    began_s: float
    gyro: GyroAngle = field(default_factory=GyroAngle)
    rest: Rest = field(default_factory=Rest)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, context: Context, services: Services, settings: CalibrateSettings) -> Script[_Desk]:
        """Find the vehicle, read the parameters in force, start recording."""
        began_s = context.now
        context.show("connect", "Waiting for the vehicle's heartbeat.", 0.0)
        identity = yield from find_vehicle(context, settings.system)
        # Only now: before, every vehicle on the link is heard.
        state = VehicleState()
        context.listeners.append(state.hear)
        context.show("connect", f"Found {identity.autopilot} {identity.kind} (system {identity.system}).")
        dialect = services.dialect_for(identity.autopilot)
        parameters = yield from dialect.compass_parameters(context)
        present = dialect.instances(parameters)
        instances = settings.instances or present
        missing = [str(i) for i in instances if i not in present]
        if missing:
            raise Refused(
                f"The vehicle has no compass {', '.join(missing)}; it has {len(present) or 'none'}.",
                "Choose with --compass, or connect and enable the compass.",
            )
        builder = TrackBuilder(identity.autopilot, identity.kind)
        builder.parameters.update(parameters)
        describe_compasses(builder, dialect, parameters)
        desk = cls(
            context, services, settings, identity, dialect, parameters, instances, state, builder, began_s
        )
        context.listeners += [builder.add, desk.gyro.hear, desk.rest.hear]
        return desk

    def mobility(self) -> Mobility:
        """Return what chooses who turns the vehicle."""
        chosen = self.settings
        wishes = Wishes(chosen.motion, chosen.turn_by, chosen.permissions, chosen.limits)
        return Mobility(self.identity, self.state, self.gyro, self.rest, wishes)

    def solve(self, windows: list[Window]) -> CalibrationReport:
        """Solve and judge every compass on what was recorded."""
        track = self.builder.build()
        world = earth_field_of(track, self.settings.year)
        if world is None and _PLACELESS not in self.notes:
            self.notes.append(_PLACELESS)
        results = tuple(self.services.solve(track, i, windows, world) for i in self.instances)
        return CalibrationReport(
            identity=self.identity,
            results=results,
            before={i: self.dialect.correction(self.parameters, i) for i in self.instances},
            track=track,
            windows=tuple(windows),
            duration_s=self.context.now - self.began_s,
            messages=tuple(self.notes),
        )

    def visit(self, mover: Mover, seen: Sequence[Window] = ()) -> Script[list[Window]]:
        """Visit the positions, or one more than were seen."""
        chosen = self.settings
        return (
            yield from visit(
                self.context,
                self.rest,
                self.gyro,
                mover,
                chosen.positions,
                chosen.step_rad,
                chosen.dwell,
                seen,
            )
        )

    def wants_more(self, report: CalibrationReport, mover: Mover) -> bool:
        """Tell whether further positions are worth their time: a person is not asked for them."""
        if isinstance(mover, HandMover) or len(report.windows) >= self.settings.most_positions:
            return False
        worst_deg = max(result.heading_sigma_deg for result in report.results)
        if worst_deg <= self.settings.enough_deg:
            return False
        self.context.show("turn", f"Heading within {worst_deg:.1f} deg so far: one more position.")
        return True

    def write(self, report: CalibrationReport) -> Script[CalibrationReport]:
        """Plan, ask where wanted, write and read back."""
        corrections = {result.instance: result.correction for result in report.results}
        plan = self.dialect.plan(self.parameters, corrections)
        self.notes += [*plan.refusals, *plan.remarks]
        report = replace(report, plan=plan, messages=tuple(self.notes))
        if plan.refusals:
            return report
        if self.settings.writing == "ask":
            lines = [f"  {c.name:<18} {c.old:>10.4g} -> {c.new:.4g}" for c in plan.changes]
            if not (yield from ask(self.context, "\n".join(["Write these parameters?", *lines]))):
                self.notes.append("Not written: the answer was no.")
                return replace(report, messages=tuple(self.notes))
        self.context.show("write", f"Writing {len(plan.changes)} parameters.")
        outcome = yield from self.dialect.write(self.context, plan, self.services.save_undo)
        for instance, correction in corrections.items():
            if self.dialect.raw_rotation(self.parameters, instance) is None:
                self.builder.set_correction(instance, correction)
        return replace(report, outcome=outcome)

    def prove_or_undo(self, report: CalibrationReport, mover: Mover) -> Script[CalibrationReport]:
        """Turn once more: the field's own heading must follow the gyro; otherwise undo.

        A proof that is cut short is none: the old values are put back.
        """
        self.context.show("prove", "One more turn proves the new values.")
        try:
            share = 1.0 if isinstance(mover, HandMover) else _PROOF_SHARE
            yield from mover.next(self.context, share * self.settings.step_rad, 1)
            window = yield from dwell(self.context, self.rest, self.gyro, mover, self.settings.dwell)
            with_it = self.solve([*report.windows, window])
        except Exception as why:
            mover.halt(self.context)
            yield from self._take_back(report, f"The proof was cut short ({why}).")
            raise
        proof = prove(with_it.track, report.windows[-1], window, report.results, with_it.results)
        report = replace(report, proof=proof, track=with_it.track, duration_s=with_it.duration_s)
        if proof.passed:
            self.context.show("prove", proof.summary(), 1.0)
            return replace(report, messages=tuple(self.notes))
        yield from self._take_back(report, proof.summary())
        self.notes.append(f"{proof.summary()} The old values were put back.")
        return replace(report, undone=True, messages=tuple(self.notes))

    def _take_back(self, report: CalibrationReport, why: str) -> Script[None]:
        """Write the old values again. Raises WriteFailed, with the way back, where that fails."""
        assert report.plan is not None and report.outcome is not None
        self.context.show("undo", f"{why} Putting the old values back.")
        try:
            yield from self.dialect.write(self.context, report.plan.reversed(), self.services.save_undo)
        except (WriteFailed, LinkError) as trouble:
            outcome = report.outcome
            raise WriteFailed(
                f"{why} The new values could not be taken back: {trouble.what}",
                f"Bring the link back, then put the old values back with: {outcome.restore_command}",
                outcome.undo_file,
                outcome.restore_command,
            ) from trouble
