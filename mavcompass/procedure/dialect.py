"""What a procedure needs of an autopilot, whichever make: implemented in `vehicle` per autopilot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import MavCompassError, WriteFailed
from mavcompass.frames import FloatArray
from mavcompass.messages import telemetry
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.script import Context, Script, T, nothing, pause
from mavcompass.steering import compasses_of
from mavcompass.track_builder import TrackBuilder

GIVEN_BACK = "The autopilot's estimator gets its own settings back; the calibration is not touched."
# A parameter, or a calibration that was loaded, is in force by then.
TAKES_S = 0.6


@dataclass(frozen=True, slots=True)
class Change:
    """Hold one parameter's old and new value."""

    name: str
    old: float
    new: float


@dataclass(frozen=True, slots=True)
class ParameterPlan:
    """Hold what a write will do, before it does it.

    Attributes:
        changes: in the order of writing; parameters that keep their value are not in it.
        refusals: sentences why this must not be written (range, arming checks); empty: may be written.
        remarks: what the person should know (reboot wanted, AUTODEC, LEARN, EKF needs time).
        commit_instances: compasses whose device id must be committed beside the parameters.
        after_restart: the parameters that take effect with the autopilot's next start.
        for_now: True where the old values are to come back at the end of the run.
    """

    changes: tuple[Change, ...]
    refusals: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    commit_instances: tuple[int, ...] = ()
    after_restart: tuple[str, ...] = ()
    for_now: bool = False


def _nothing_to_take_back(context: Context, why: str) -> Script[None]:
    return nothing(None)


@dataclass(frozen=True, slots=True)
class WriteOutcome:
    """Say how a write ended: every value read back equal, where its undo lies, what else to know.

    `restore_command` is what a person types to put the old values back, `again_command` to write the new ones
    once more. `take_back`, given the time and a sentence why, writes the old values again, proves them and
    removes the undo record; it raises WriteFailed where that fails.
    """

    verified: bool
    undo_file: Path | None
    values: Mapping[str, float]
    remarks: tuple[str, ...] = ()
    restore_command: str = ""
    again_command: str = ""
    take_back: Callable[[Context, str], Script[None]] = _nothing_to_take_back


NOT_TURNED: Mapping[int, FloatArray] = MappingProxyType({})

# Puts an undo record of a vehicle on disk before the first write and returns its path; injected, as
# procedures do not touch files.
SaveUndo = Callable[[ParameterPlan, Mapping[str, float], Nameplate], Path]
# Lists what runs that were cut short have left at other values on a vehicle, the last first: the old values,
# their record, and what removes it; injected, too.
CutShort = Callable[[Nameplate], Sequence[tuple[Mapping[str, float], Path, Callable[[], None]]]]


class Dialect(ABC):
    """Speak one autopilot's parameters; all methods are scripts or pure. `vehicle.dialects` has one for each.

    Attributes:
        autopilot: its name.
        loads_disarmed: True where what is written in flight is not in force before it is disarmed.
        restart_wanted_by_own: True where, once its own calibration has begun, it arms only after a restart.
    """

    autopilot: Literal["ardupilot", "px4"]
    loads_disarmed: bool = False
    restart_wanted_by_own: bool = False

    @abstractmethod
    def read_parameters(self, context: Context, names: Sequence[str]) -> Script[dict[str, float]]:
        """Read parameters by name; a name that the vehicle does not know is absent from the answer."""

    @abstractmethod
    def compass_parameters(self, context: Context) -> Script[dict[str, float]]:
        """Read everything about all compasses that a calibration and its checks need."""

    @abstractmethod
    def claim(self, context: Context, parameters: Mapping[str, float]) -> Script[Nameplate]:
        """Find out which vehicle this is, and hold it against other programs until the procedure ends.

        Raises Refused where another program works on it.
        """

    def instances(self, parameters: Mapping[str, float], reporting: Iterable[int] = ()) -> tuple[int, ...]:
        """List the compasses that the vehicle has, from 1, given those that were heard."""
        return compasses_of(self.autopilot, parameters, reporting)

    @abstractmethod
    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes."""

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return the sensor-to-body rotation where telemetry carries the uncorrected sensor's axes.

        None where the autopilot applies its correction before it reports.
        """
        return None

    @abstractmethod
    def plan(
        self,
        parameters: Mapping[str, float],
        corrections: Mapping[int, FieldCorrection],
        turned: Mapping[int, FloatArray] = NOT_TURNED,
        reporting: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of new corrections over the parameters in force, and of new mountings.

        `turned` has, by instance, the rotation (3, 3) that must come after the sensor-to-body rotation in
        force; such a compass's correction is for raw readings in the new body axes. A mounting that the
        autopilot cannot hold is a refusal, in words.
        """

    @abstractmethod
    def write(self, context: Context, plan: ParameterPlan, save_undo: SaveUndo) -> Script[WriteOutcome]:
        """Write a plan: undo file first, each value read back, all undone on any failure.

        Raises WriteFailed where it could not be completed, saying what is left and what restores it.
        """

    @abstractmethod
    def arming_exemption(self, context: Context, reasons: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return the parameters that keep one arming check from looking at the compass's calibration.

        `reasons` are the vehicle's not to arm; empty where they name anything beside that, or nothing.
        """

    @abstractmethod
    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return parameters at which the estimator follows its compass within seconds; {} where none do."""

    def take_compass_yaw(
        self, context: Context, parameters: Mapping[str, float], flying: bool
    ) -> Script[str]:
        """Have the autopilot take its compass's yaw over at once, in a way that needs no permission.

        Returns how, in words that follow "by"; "" where it knows no such way as it is now.
        """
        return (yield from nothing(""))

    def load_written(self, context: Context, written: Mapping[str, float]) -> Script[str]:
        """Have an autopilot that `loads_disarmed`, and now is, load these parameters again.

        Returns how that brings its heading right, in words that follow "by"; "" where it does not.
        """
        return (yield from nothing(""))

    @abstractmethod
    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List the parameters, of these, that its own calibration may change by itself."""

    @abstractmethod
    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have the autopilot calibrate compasses by its own method while a person turns the vehicle.

        However it ends, nothing of it runs on. Raises Refused where it does not begin, PoorCalibration where
        the vehicle is not turned, LinkLost where it falls silent.
        """


@dataclass(slots=True)
class Overrides:
    """Hold parameters of a vehicle at other values for a while.

    Each set is written as a transaction with an undo record of its own, which is removed with it. Records
    that are saved meanwhile hold its old values too: after a kill the newest one leads back to everything.
    """

    dialect: Dialect
    save: SaveUndo
    _held: list[tuple[ParameterPlan, WriteOutcome]] = field(default_factory=list)

    def save_undo(self, plan: ParameterPlan, parameters: Mapping[str, float], vehicle: Nameplate) -> Path:
        """Save an undo record, with what is held now."""
        held = tuple(Change(c.name, c.old, c.old) for taken, _ in self._held for c in taken.changes)
        return self.save(replace(plan, changes=(*plan.changes, *held)), parameters, vehicle)

    def hold(self, context: Context, values: Mapping[str, float]) -> Script[bool]:
        """Write these values for now; False, and nothing written, where the vehicle lacks one of them.

        Raises what a transaction raises.
        """
        known = yield from self.dialect.read_parameters(context, tuple(values))
        if set(known) != set(values):
            return False
        changes = tuple(Change(n, known[n], v) for n, v in values.items() if known[n] != v)
        plan = ParameterPlan(changes, for_now=True)
        outcome = yield from self.dialect.write(context, plan, self.save_undo)
        if outcome.undo_file is not None:
            self._held.append((plan, outcome))
        return True

    def keep(self, context: Context, names: Sequence[str]) -> Script[None]:
        """Record parameters that the autopilot itself is going to change, for `release` to put back.

        Raises what a transaction raises.
        """
        values = yield from self.dialect.read_parameters(context, names)
        plan = ParameterPlan(tuple(Change(n, v, v) for n, v in values.items()), for_now=True)
        if values:
            self._held.append((plan, (yield from self.dialect.write(context, plan, self.save_undo))))

    def load(
        self, context: Context, parameters: Mapping[str, float], written: Mapping[str, float]
    ) -> Script[str]:
        """Have an autopilot that `loads_disarmed`, and now is, load what was written, and follow its compass.

        Returns how that brings its heading right, in words that follow "by"; "" where it does not.
        """

        def loading() -> Script[str]:
            prompt = self.dialect.prompt_estimator(parameters, flying=False)
            if prompt and (yield from self.hold(context, prompt)):
                yield from pause(context, TAKES_S)
            how = yield from self.dialect.load_written(context, written)
            yield from pause(context, TAKES_S)
            return how

        return (yield from self.put_back_after(context, loading(), GIVEN_BACK))

    def put_back_left(self, context: Context, cut_short: CutShort) -> Script[dict[str, float]]:
        """Put back what earlier runs have left, which were killed, and return it.

        Raises what a transaction raises.
        """
        back: dict[str, float] = {}
        vehicle = yield from self.dialect.claim(context, {})
        for before, record, done in cut_short(vehicle):
            now = yield from self.dialect.read_parameters(context, tuple(before))
            changes = tuple(Change(n, now[n], old) for n, old in before.items() if now.get(n, old) != old)
            if changes:
                context.show("undo", f"An earlier run was cut short: {changes[0].name} is put back.")
                yield from self.dialect.write(context, ParameterPlan(changes), lambda *_, at=record: at)
            back |= before
            done()
        return back

    def put_back_after(self, context: Context, work: Script[T], why: str) -> Script[T]:
        """Do some work, then put back all that is held, however it ends; its own error goes first.

        What could not be put back stands beside its remedy; the record of a WriteFailed holds that already.
        Raises WriteFailed where the putting back alone fails.
        """
        try:
            done = yield from work
        except Exception as error:
            try:
                yield from self.release(context, why)
            except MavCompassError as left:
                if isinstance(error, MavCompassError) and not isinstance(error, WriteFailed):
                    error.remedy = f"{error.remedy} {left.remedy}".strip()
            raise
        yield from self.release(context, why)
        return done

    def release(self, context: Context, why: str) -> Script[None]:
        """Put back all that is held, the last first. Raises WriteFailed where that fails."""
        while self._held:
            yield from self._held.pop()[1].take_back(context, why)


def describe_compasses(builder: TrackBuilder, dialect: Dialect, parameters: Mapping[str, float]) -> None:
    """Tell a recording what telemetry has done to each compass's readings: corrected, or raw and turned."""
    for instance in dialect.instances(parameters, telemetry.MAG_MESSAGES.values()):
        in_force = dialect.correction(parameters, instance)
        rotation = dialect.raw_rotation(parameters, instance)
        if rotation is None:
            builder.set_correction(instance, in_force)
        else:
            builder.set_correction(instance, IDENTITY)
            builder.set_raw(instance, rotation, in_force)
