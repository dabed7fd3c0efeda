"""What the dialects of all autopilots have in common: reading, planning and writing compass parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.correction import FieldCorrection
from mavcompass.errors import NoReply
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import NOT_TURNED, ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate, read_nameplate
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.steering import compasses_of
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.planning import Planner
from mavcompass.vehicle.parameters.rules import ParameterRules, parameter_rules
from mavcompass.vehicle.parameters.transaction import Commit, Transaction
from mavcompass.vehicle.parameters.values import Encoding, Parameter


class CompassDialect(ABC):
    """Speak one autopilot's compass parameters; implements `procedure.dialect.Dialect`.

    Attributes:
        autopilot: its name. prefix: what the names of its compass parameters begin with, one of them.
        encoding: how it puts integers into PARAM_VALUE. planner_kind: what plans its writes.
        commit: what must be done beside the parameters after they are written.
        loads_disarmed: True where what is written in flight is not in force before it is disarmed.
        restart_wanted_by_own: True where, once its own calibration has begun, it arms only after a restart.
    """

    autopilot: Literal["ardupilot", "px4"]
    prefix: tuple[str, ...]
    encoding: Encoding
    planner_kind: type[Planner]
    commit: Commit | None = None
    loads_disarmed: bool = False
    restart_wanted_by_own: bool = False

    def __init__(self, source: str = "SOURCE") -> None:
        """Take the vehicle's address, which error messages repeat in the command that restores."""
        self.source = source
        self._nameplate: Nameplate | None = None

    @abstractmethod
    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses and what `rules.vehicle` adds, with types.

        Raises NoReply where the vehicle answers nothing, LinkLost where it says nothing at all.
        """

    @abstractmethod
    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""

    @abstractmethod
    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes."""

    @abstractmethod
    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return the sensor-to-body rotation where telemetry carries the uncorrected sensor's axes."""

    def instances(self, parameters: Mapping[str, float], reporting: Iterable[int] = ()) -> tuple[int, ...]:
        """List the compasses that the vehicle has; see `compasses_of`."""
        return compasses_of(self.autopilot, parameters, reporting)

    @property
    def rules(self) -> ParameterRules:
        """Return the limits and write rules of `params/`."""
        return parameter_rules(self.autopilot)

    @property
    def planner(self) -> Planner:
        """Return what plans its writes."""
        return self.planner_kind(self.rules)

    def read_typed(self, context: Context, names: Sequence[str]) -> Script[dict[str, Parameter]]:
        """Read parameters with their types; a name that the vehicle does not know is left out."""
        return (yield from protocol.read(context, names, self.encoding))

    def read_parameters(self, context: Context, names: Sequence[str]) -> Script[dict[str, float]]:
        """Read parameters by name; a name that the vehicle does not know is left out."""
        held = yield from self.read_typed(context, names)
        return {name: parameter.value for name, parameter in held.items()}

    def compass_parameters(self, context: Context) -> Script[dict[str, float]]:
        """Read everything about all compasses, as `compass_parameters_typed` does."""
        held = yield from self.compass_parameters_typed(context)
        return {name: parameter.value for name, parameter in held.items()}

    def nameplate(self, context: Context, parameters: Mapping[str, float]) -> Script[Nameplate]:
        """Find out which vehicle this is, once for all."""
        if self._nameplate is None:
            devices = self.device_ids(parameters)
            self._nameplate = yield from read_nameplate(context, self.autopilot, devices)
        return self._nameplate

    def claim(self, context: Context, parameters: Mapping[str, float]) -> Script[Nameplate]:
        """Find out which vehicle this is, and hold it against other programs until the procedure ends.

        Raises Refused where another program works on it.
        """
        plate = yield from self.nameplate(context, parameters)
        context.hold(plate)
        return plate

    def plan(
        self,
        parameters: Mapping[str, float],
        corrections: Mapping[int, FieldCorrection],
        turned: Mapping[int, FloatArray] = NOT_TURNED,
        reporting: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of new corrections over the parameters in force, and of new mountings."""
        return self.planner.plan(parameters, corrections, self.instances(parameters, reporting), turned)

    def plan_values(
        self,
        parameters: Mapping[str, float],
        wanted: Mapping[str, float],
        checked: bool = True,
        reporting: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of single parameters; unchecked, what is out of range is only remarked on."""
        present = self.instances(parameters, reporting)
        return self.planner.plan_values(parameters, wanted, present, checked)

    def write(self, context: Context, plan: ParameterPlan, save_undo: SaveUndo) -> Script[WriteOutcome]:
        """Write a plan as a transaction; see `vehicle.parameters.transaction`."""
        transaction = Transaction(self.encoding, self.source, self._claimed, self.commit)
        return (yield from transaction.run(context, plan, save_undo))

    def _claimed(self, context: Context) -> Script[Nameplate]:
        known = self._nameplate is not None
        parameters = {} if known else (yield from self.compass_parameters(context))
        return (yield from self.claim(context, parameters))

    @abstractmethod
    def arming_exemption(self, context: Context, said: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return the parameters that keep one arming check from looking at the compass's calibration."""

    @abstractmethod
    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List the parameters, of these, that its own calibration may change by itself."""

    @abstractmethod
    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have the autopilot calibrate compasses by its own method while a person turns the vehicle."""

    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return at what the estimator follows its compass; by itself a dialect knows no such values."""
        return {}

    def take_compass_yaw(
        self, context: Context, parameters: Mapping[str, float], flying: bool
    ) -> Script[str]:
        """Have the autopilot take its compass's yaw over at once; by itself a dialect knows no way."""
        return (yield from nothing(""))

    def load_written(self, context: Context, written: Mapping[str, float]) -> Script[str]:
        """Have the autopilot load what was written; what is in force at once needs no loading."""
        return (yield from nothing(""))


def no_answer() -> NoReply:
    """Say that a vehicle is there but told nothing about its compasses."""
    return NoReply(
        "The vehicle is alive but answered no question about its compass parameters.",
        "Check that the link carries both ways and that the firmware has a compass.",
    )
