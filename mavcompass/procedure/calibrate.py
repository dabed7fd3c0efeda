"""The calibration: four positions, a solution, a verdict, a verified write, a proof.

Read `calibrate` from top to bottom: it is the product. It runs as a `Machine` (see `script`), so it
neither sleeps nor reads a clock nor touches a socket or a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult, OwnFinding, summary
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import LinkLost, PoorCalibration, Refused
from mavcompass.procedure.autopilot_heading import OwnHeading
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import Change, CutShort, Dialect, Overrides, SaveUndo, WriteOutcome
from mavcompass.procedure.motion import Mobility
from mavcompass.procedure.positions import Mover, Window, dwell, prove, stood_since, turn_through, visit
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Ask, Context, Script, ask
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.writing import Writer, restart
from mavcompass.track import Track

# What is left of a bar then is the autopilot's own heading, which comes right by itself or not.
_PROVEN = 0.95
# Slower than any way turns a vehicle: this is sway, or what a hull glides on.
_TURNING_DPS = 3.0
# So long a stopped vehicle is watched; what is told after it would be told of a turn that goes on.
_HALTS_WITHIN_S = 5.0
# Midway between two positions proves as much as at the next one, and takes less of the vehicle's time.
_PROOF_SHARE = 0.5
# And so sure a heading: a third of what the field may turn more or less than the gyro.
_PROOF_ENOUGH_DEG = 0.5
# Its turn is known live as well as the gyro's bias, and an autopilot whose own heading comes right meanwhile
# may undo what it was told to turn.
_PROOF_TURNS = 3
_UNPROVEN = "Not proven by a turn: restart the autopilot, then see with the check that all is right."
_RESTART = "Once its own calibration has begun the autopilot arms only after a restart (--reboot)."
# ArduPilot's estimator counts on its compass for no more while nothing is set (EK3_YAW_M_NSE, half a radian).
_ROUGH_DEG = math.degrees(0.5)
# Silent for so long after a stop, the vehicle was not stopped but lost.
_LOST_S = 2.5

# What an autopilot's own calibration found, by compass.
Found = Mapping[int, OwnFinding]
# Solves and judges compasses of a Track from the still stretches that the procedure chose, as was wanted.
Solve = Callable[
    [Track, tuple[int, ...], list[Window], EarthField | None, CalibrateSettings, Found],
    tuple[CalibrationResult, ...],
]


@dataclass(frozen=True, slots=True)
class Services:
    """Hold what the procedure needs from rooms that it may not import."""

    dialect_for: Callable[[str], Dialect]
    save_undo: SaveUndo
    solve: Solve
    cut_short: CutShort = lambda vehicle: ()


def calibrate(context: Context, services: Services, settings: CalibrateSettings) -> Script[CalibrationReport]:
    """Calibrate a live vehicle's compasses.

    Raises Refused where the vehicle must not be turned or was stopped, LinkError where it cannot be
    heard, WriteFailed where values were left half written, PoorCalibration where no solution exists.
    A solution that is not good enough is in the report, not accepted, and nothing is written.
    """
    desk = yield from Desk.open(context, services.dialect_for, settings.system)
    overrides = Overrides(desk.dialect, services.save_undo)
    own = OwnHeading(desk, settings.year, overrides)
    work = _Calibration(desk, services, settings, desk.chosen(settings.instances), overrides, own)
    try:
        return (yield from work.run())
    except Refused as why:
        if context.now - desk.state.heard_s > _LOST_S:
            remedy = "Bring the link back (power, cable, radio), then run again."
            raise LinkLost(why.what, remedy) from why
        yield from work.halts()
        raise Refused(" ".join((why.what, *work.what_stands())), why.remedy) from why


@dataclass(slots=True)
class _Calibration:
    """Do the work of one calibration, step by step."""

    desk: Desk
    services: Services
    settings: CalibrateSettings
    instances: tuple[int, ...]
    overrides: Overrides
    own: OwnHeading
    writer: Writer | None = None
    mobility: Mobility = field(init=False)
    found: Found = field(default_factory=dict)
    rough: tuple[Change, ...] = ()
    restart: bool = False

    @property
    def rate_dps(self) -> float:
        """Return how fast the vehicle turns, 0 while it has not told."""
        attitude = self.desk.state.attitude
        return 0.0 if attitude is None else math.degrees(abs(attitude.yawspeed))

    def halts(self) -> Script[None]:
        """Wait until a vehicle that was told to halt has done so."""
        end_s = self.desk.context.now + _HALTS_WITHIN_S
        while self.rate_dps > _TURNING_DPS and self.desk.context.now < end_s:
            yield end_s

    def what_stands(self) -> Iterator[str]:
        """Say, where it is ended before its time, whether the vehicle moves and what has been written."""
        if self.desk.state.attitude is not None:
            armed = "armed" if self.desk.state.armed else "disarmed"
            turning = f"It is still turning, by {self.rate_dps:.0f} deg/s, {armed}: keep clear."
            yield turning if self.rate_dps > _TURNING_DPS else f"It no longer turns; it is {armed}."
        if self.writer is None or not self.writer.began:
            yield "Nothing written."
            if self.restart:
                yield _RESTART
        elif self.writer.taken_back:
            yield "The old values are back on the vehicle."

    def run(self) -> Script[CalibrationReport]:
        """Calibrate, and see that the autopilot steers by it; put every rate back however it ends."""
        context, rates = self.desk.context, MessageRates()
        self.desk.rest.compasses = self.instances
        try:
            if self.settings.writing != "never":
                self.desk.now_in_force(
                    (yield from self.overrides.put_back_left(context, self.services.cut_short))
                )
            yield from rates.ask(context, self.wanted_rates())
            why = "What was set for the calibration alone is put back."
            report = yield from self.overrides.put_back_after(context, self.calibrate(), why)
            if report.written:
                report = yield from self.steer_by_it(report, rates)
            elif report.accepted and not report.to_write:
                report = replace(report, heading=replace(self.own.outcome(), written=False))
            return report.noting(_RESTART) if self.restart else report
        finally:
            yield from _whatever_comes(lambda _: rates.restore(context))

    def calibrate(self) -> Script[CalibrationReport]:
        """Visit the positions, solve, write, prove; give the vehicle back however it ends."""
        desk, settings, finished = self.desk, self.settings, False
        wanted = (settings.moved_by, settings.turn_by, settings.permissions)
        self.mobility = mobility = Mobility(desk, *wanted, self.overrides, settings.continuous)
        self.writer = writer = Writer(
            desk, self.overrides.save_undo, settings.writing == "ask", self.just_before
        )
        try:
            mover = yield from mobility.take_charge()
            if settings.continuous and not mover.by_itself:  # a person is told to stop
                self.settings = settings = replace(settings, continuous=False)
            if settings.by_autopilot:
                yield from self.by_itself()
            report = self.solve((yield from self.visit(mover)))
            while self.wants_more(report, mover):
                report = self.solve((yield from self.visit(mover, report.windows)))
            for result in report.results:
                desk.context.show("solve", summary(result), settings.planned / (settings.planned + 1.0))
            report = yield from self.as_mounted(report)
            mover.halt(desk.context)  # nothing is asked of the vehicle while values are written
            stood, bent_deg = report.windows, 0.0
            if settings.continuous:  # only before the turn; there it may have been right by chance
                stood, bent_deg = stood[:1], max((r.heading_change_deg for r in report.to_write), default=0.0)
            self.own.found(report.results, [(w.start_s, w.end_s) for w in stood], bent_deg)
            if report.accepted and report.to_write and settings.writing != "never":
                last = report.windows[-1]
                if settings.continuous:
                    last = yield from stood_since(desk.context, mover, last, settings.dwell)
                report = yield from writer.write(report)
                if report.takes_effect_later:
                    report = report.noting(_UNPROVEN)
                elif report.outcome is not None:
                    report = yield from self.prove_or_undo(report, report.outcome, mover, writer, last)
            finished = True
            return report
        finally:
            yield from _whatever_comes(lambda hurried: mobility.end(hurried or not finished))

    def by_itself(self) -> Script[None]:
        """Have the autopilot calibrate by its own method; what it has stored by itself is put back."""
        desk = self.desk
        names = desk.dialect.changed_by_own(desk.parameters)
        yield from self.overrides.keep(desk.context, names)
        self.restart = desk.dialect.restart_wanted_by_own
        self.found = yield from desk.dialect.calibrate_itself(desk.context, desk.parameters, self.instances)
        yield from self.overrides.release(desk.context, "What it stored is judged first.")
        why = [finding.why_not for finding in self.found.values() if finding.why_not]
        if len(why) == len(self.found):
            raise PoorCalibration(why[0], _RESTART if self.restart else "")
        desk.context.show("turn", "Its own calibration has ended.")

    def wanted_rates(self) -> dict[type[mav.Message], float]:
        """List the messages to ask for."""
        wanted = self.desk.calibration_rates(self.instances, self.settings.rate_hz)
        if self.settings.by_autopilot:
            wanted |= dict.fromkeys((mav.MagCalProgress, mav.MagCalReport), 4.0)
        return wanted

    def visit(self, mover: Mover, seen: Sequence[Window] = ()) -> Script[list[Window]]:
        """Visit the positions, or one more than were seen, and leave the vehicle to itself.

        Solving takes a small computer seconds, in which nothing is sent: no vehicle may depend on that.
        """
        desk, settings = self.desk, self.settings
        go = turn_through if settings.continuous else partial(visit, between=self.know_roughly)
        how = (settings.planned, settings.step_rad, settings.dwell)
        desk.now_in_force({change.name: change.new for change in self.rough})
        windows = yield from go(desk.context, mover, *how, seen, self.own.keep_up, self.sureness_deg)
        yield from mover.release(desk.context)
        # Until the write it stands, and what is found is held against what was in force at the beginning.
        desk.now_in_force({change.name: change.old for change in self.rough})
        return windows

    def know_roughly(self, windows: list[Window]) -> Script[None]:
        """Have what a quarter turn has shown in force where the vehicle would go astray by what is.

        Until the write, with a way back as of any. A rover with 300 mG of iron, more than the Earth's 230,
        was 15 m away before its third quarter turn. In the air a yaw that jumps is worse than one that is
        off, and PX4 loads nothing while it is armed.
        """
        desk = self.desk
        late = self.own.flying or desk.dialect.loads_disarmed or self.settings.writing == "never"
        if len(windows) != 2 or late or not self.mobility.steers_astray:
            return
        roughly = replace(self.settings, method="touch-up", max_heading_error_deg=_ROUGH_DEG)
        try:
            results = self.solve(windows, roughly).results
        except PoorCalibration:
            return
        corrections = {r.instance: r.correction for r in results if r.accepted and not r.already_right}
        plan = desk.dialect.plan(desk.parameters, corrections, reporting=desk.state.reporting)
        rough = {change.name: change.new for change in plan.changes}
        if rough and not plan.refusals and (yield from self.overrides.hold(desk.context, rough)):
            self.rough = plan.changes
            desk.now_in_force(rough)
            yield from self.own.keep_up()

    def just_before(self) -> Script[None]:
        """Put back what was known roughly, and have the estimator expect what is written now."""
        if self.rough:
            yield from self.overrides.release(self.desk.context, "It has turned.")
        yield from self.own.expect()

    @property
    def heard(self) -> tuple[int, ...]:
        """Return the compasses that readings came of; one that was named stays, and is missed.

        Parameters keep the ids of sensors that are no longer there.
        """
        heard = tuple(i for i in self.instances if i in self.desk.state.reporting)
        return self.instances if self.settings.instances else heard or self.instances

    def sureness_deg(self, start_s: float, end_s: float) -> float:
        """Return how far the heading by one still stretch may be off, 1 sigma, of the worst compass."""
        return self.desk.sureness_deg(self.heard, start_s, end_s, self.settings.year)

    def solve(self, windows: list[Window], settings: CalibrateSettings | None = None) -> CalibrationReport:
        """Solve and judge every compass on what was recorded."""
        desk, settings = self.desk, settings or self.settings
        track = desk.builder.build()
        world = earth_field_of(track, settings.year)
        heard = self.heard
        results = self.services.solve(track, heard, windows, world, settings, self.found)
        if settings.rewrite:
            results = tuple(replace(result, already_right=False) for result in results)
        return CalibrationReport(
            identity=desk.identity,
            results=results,
            before={i: desk.dialect.correction(desk.parameters, i) for i in heard},
            track=track,
            windows=tuple(windows),
            duration_s=desk.duration_s(),
            messages=tuple(
                f"No readings of compass {i} came: its parameters stay as they are."
                for i in self.instances
                if i not in heard
            ),
            vehicle=desk.vehicle,
        )

    def as_mounted(self, report: CalibrationReport) -> Script[CalibrationReport]:
        """Take compasses that are mounted turned as they are mounted, where that is wanted."""
        results = list(report.results)
        for k, result in enumerate(results):
            mended, wanted = result.mounting.mended, self.settings.orientation
            if mended is None or self.settings.writing == "never":
                continue
            if not wanted and self.settings.writing == "ask":
                question = Ask("Set how it is mounted, with the calibration for it?", result.reasons[:1])
                wanted = yield from ask(self.desk.context, question)
            if wanted:
                results[k] = mended
        return replace(report, results=tuple(results))

    def wants_more(self, report: CalibrationReport, mover: Mover) -> bool:
        """Tell whether further positions are worth their time.

        A person is not asked for them; what has strayed that far may be stopped, and lose what it has.
        """
        if not (mover.by_itself and self.mobility.has_room) or len(report.windows) >= self.settings.at_most:
            return False
        # One that is mounted turned is as sure as it will be once that is set right.
        as_mounted = (result.mounting.mended or result for result in report.results)
        worst_deg = max(result.repeatable_sigma_deg for result in as_mounted)
        if worst_deg <= self.settings.enough_deg:
            return False
        self.desk.context.show("turn", f"Heading within {worst_deg:.1f} deg so far: one more position.")
        return True

    def steer_by_it(self, report: CalibrationReport, rates: MessageRates) -> Script[CalibrationReport]:
        """Wait until the autopilot steers by the new heading, and say how far off it is."""
        own, outcome = self.own, report.outcome
        assert outcome is not None
        if self.restart:  # what the hands did to its estimator ends with that only
            yield from own.look()
        else:
            yield from own.settle()
        if self.settings.reboot and (own.outcome().is_off or report.takes_effect_later or self.restart):
            try:
                yield from restart(self.desk, rates, self.wanted_rates(), outcome)
                own.restarted()
                self.restart = False
                yield from own.settle()
            except (Refused, LinkLost) as trouble:
                report = report.noting(str(trouble))
        return replace(report, heading=own.outcome())

    def prove_or_undo(
        self, report: CalibrationReport, outcome: WriteOutcome, mover: Mover, writer: Writer, last: Window
    ) -> Script[CalibrationReport]:
        """Turn once more: the field's own heading must follow the gyro; otherwise undo.

        A proof that is cut short, or not begun, is none: the old values are put back.
        """
        context, settings = self.desk.context, self.settings
        try:
            if not settings.continuous:
                yield from self.own.written(outcome.values)
            doing = "Measuring" if settings.stands else "Turning"
            context.show("prove", f"{doing} once more to check the new values.")
            enough = replace(settings.dwell, enough_deg=_PROOF_ENOUGH_DEG)
            if self.desk.gyro.broken_s > last.end_s and not settings.stands:
                # While all was solved more may have come than the port keeps, and a copter turns in HOLD.
                last = yield from dwell(context, mover, enough, self.sureness_deg)
            turned_rad = self.desk.gyro.angle_rad - last.turned_rad
            for _ in range(_PROOF_TURNS):
                angle_rad = settings.step_rad
                if mover.by_itself:
                    # What the autopilot has turned by itself, its heading being right now, counts.
                    angle_rad = _PROOF_SHARE * angle_rad - turned_rad
                yield from mover.next(context, angle_rad, 1)
                window = yield from dwell(context, mover, enough, self.sureness_deg)
                yield from mover.release(context)
                track, duration_s = self.desk.builder.build(), self.desk.duration_s()
                # What the autopilot found does not depend on a further position.
                again = report.results
                if not settings.by_autopilot:
                    again = self.solve([*report.windows, window]).results
                proof = prove(track, last, window, report.results, again, not settings.stands)
                if proof.tells:
                    break
                turned_rad = math.radians(proof.compasses[0].gyro_turned_deg)
            if settings.continuous and proof.passed:  # no turn waits for the autopilot to follow
                yield from self.own.written(outcome.values)
        except Exception as why:
            self.mobility.halt()
            yield from writer.take_back(report, f"The proof was cut short ({why}).")
            raise
        report = replace(
            report,
            proof=proof,
            on_vehicle_s=window.end_s - report.windows[0].start_s,
            track=track,
            duration_s=duration_s,
        )
        if proof.passed:
            context.show("prove", proof.summary(), _PROVEN)
            yield from _whatever_comes(lambda _: self.own.give_back())
            return report
        yield from writer.take_back(report, proof.summary())
        return replace(report, undone=True).noting(f"{proof.summary()} The old values were put back.")


def _whatever_comes(put_back: Callable[[bool], Script[None]]) -> Script[None]:
    """Give something back; a stop that comes now finds nothing moving and only means to hurry."""
    try:
        yield from put_back(False)
    except Refused:
        yield from put_back(True)
