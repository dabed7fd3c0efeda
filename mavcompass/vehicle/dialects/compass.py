"""What the dialects of all autopilots have in common: reading, planning and writing compass parameters."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from mavcompass.correction import FieldCorrection
from mavcompass.errors import NoReply, Refused
from mavcompass.frames import FloatArray
from mavcompass.parameter_remarks import parameter_remarks
from mavcompass.printable import named
from mavcompass.procedure.dialect import NOT_TURNED, Change, Dialect, ParameterPlan, SaveUndo, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate, read_nameplate
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.rules import ParameterRules, parameter_rules
from mavcompass.vehicle.parameters.transaction import Transaction
from mavcompass.vehicle.parameters.values import Encoding, Parameter, is_single, same_value, tidy

# Reasons against a write, and what a person should know of it.
Judgement = tuple[list[str], list[str]]


class CompassDialect(Dialect):
    """Speak one autopilot's compass parameters, by its rules; a subclass knows them.

    Attributes:
        prefix: what the names of its compass parameters begin with, one of them.
        encoding: how it puts integers into PARAM_VALUE.
        motor_terms: the names of motor terms, a pattern. motor_switch: what says with which load all go.
        unwatched: what to know where values are written by hand, and nobody watches the autopilot's heading.
    """

    prefix: tuple[str, ...]
    encoding: Encoding
    motor_terms: str
    motor_switch: str
    unwatched: tuple[str, ...] = ()

    def __init__(self, source: str = "SOURCE") -> None:
        """Take the vehicle's address, which error messages repeat in the command that restores."""
        self.source = source
        self._nameplate: Nameplate | None = None

    # --- what a subclass knows ----------------------------------------------------------------------

    @abstractmethod
    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses and what `rules.vehicle` adds, with types.

        Raises NoReply where the vehicle answers nothing, LinkLost where it says nothing at all.
        """

    @abstractmethod
    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""

    @staticmethod
    @abstractmethod
    def instance_of(name: str) -> int | None:
        """Tell which compass, from 1, a parameter belongs to; None for one of all compasses."""

    @abstractmethod
    def absent(self, instance: int) -> str:
        """Say that there is no such compass."""

    @abstractmethod
    def wish(
        self,
        parameters: Mapping[str, float],
        instance: int,
        correction: FieldCorrection,
        turned: FloatArray | None,
    ) -> dict[str, float]:
        """Spell a correction of finite numbers as parameters, less what has the same effect already.

        `turned` is what must come after the mounting in force, None where that stays. Raises Refused for what
        no parameters can hold.
        """

    @abstractmethod
    def judge_compass(
        self, before: Mapping[str, float], after: Mapping[str, float], instance: int
    ) -> Judgement:
        """Check what a compass would hold: reasons against it, and what a person should know."""

    @abstractmethod
    def in_order(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """Put changes in the order of writing, which is undone from its end."""

    def uncommitted(
        self, before: Mapping[str, float], after: Mapping[str, float], judged: Iterable[int]
    ) -> tuple[int, ...]:
        """List compasses whose device id must be committed beside the parameters."""
        return ()

    def commit(self, context: Context, plan: ParameterPlan) -> Script[tuple[str, ...]]:
        """Do what must be done beside the parameters after they are written; return what to know of it."""
        return (yield from nothing(()))

    # --- reading ------------------------------------------------------------------------------------

    @property
    def rules(self) -> ParameterRules:
        """Return the limits and write rules of `params/`."""
        return parameter_rules(self.autopilot)

    def read_typed(self, context: Context, names: Sequence[str]) -> Script[dict[str, Parameter]]:
        """Read parameters with their types; a name that the vehicle does not know is left out."""
        return (yield from protocol.read(context, names, self.encoding))

    def read_parameters(self, context: Context, names: Sequence[str]) -> Script[dict[str, float]]:
        """Read parameters by name; a name that the vehicle does not know is left out."""
        return numbers((yield from self.read_typed(context, names)))

    def compass_parameters(self, context: Context) -> Script[dict[str, float]]:
        """Read everything about all compasses, as `compass_parameters_typed` does.

        Raises Refused where one is not a number: what the firmware makes of its readings, nobody can tell.
        """
        held = numbers((yield from self.compass_parameters_typed(context)))
        if not_numbers := [name for name, value in held.items() if not math.isfinite(value)]:
            raise Refused(
                f"{named(not_numbers)} of this vehicle: not a number. What it makes of the readings, nobody"
                " can tell.",
                "Set it anew in a ground station (offsets and motor terms to 0, DIA to 1), and restart the"
                " autopilot.",
            )
        return held

    def nameplate(self, context: Context, parameters: Mapping[str, float]) -> Script[Nameplate]:
        """Find out which vehicle this is, once for all."""
        if self._nameplate is None:
            devices = self.device_ids(parameters)
            self._nameplate = yield from read_nameplate(context, self.autopilot, devices)
        return self._nameplate

    def claim(self, context: Context, parameters: Mapping[str, float]) -> Script[Nameplate]:
        """Find out which vehicle this is, and hold it against other programs until the procedure ends."""
        plate = yield from self.nameplate(context, parameters)
        context.hold(plate)
        return plate

    def _claimed(self, context: Context) -> Script[Nameplate]:
        known = self._nameplate is not None
        parameters = {} if known else (yield from self.compass_parameters(context))
        return (yield from self.claim(context, parameters))

    # --- planning and writing -----------------------------------------------------------------------

    def plan(
        self,
        parameters: Mapping[str, float],
        corrections: Mapping[int, FieldCorrection],
        turned: Mapping[int, FloatArray] = NOT_TURNED,
        reporting: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of new corrections and mountings, by instance from 1, over the parameters in force.

        What has the same effect as before is left alone.
        """
        present = self.instances(parameters, reporting)
        wanted: dict[str, float] = {}
        unwritable: list[str] = []
        for instance, correction in sorted(corrections.items()):
            if instance not in present:
                unwritable.append(self.absent(instance))
            else:
                held = {**parameters, **wanted}  # where another compass has just taken a set of free angles
                try:
                    wanted |= self.wish(held, instance, correction, turned.get(instance))
                except Refused as refusal:
                    unwritable.append(str(refusal))
        touched = [instance for instance in corrections if instance in present]
        plan = self.plan_values(parameters, wanted, reporting=reporting, touched=touched)
        return replace(plan, refusals=(*unwritable, *plan.refusals))

    def plan_values(
        self,
        parameters: Mapping[str, float],
        wanted: Mapping[str, float],
        checked: bool = True,
        reporting: Iterable[int] = (),
        touched: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of single parameters; unchecked, what is out of range is only remarked on.

        `reporting` are the compasses that were heard; `touched` are compasses to judge even if none of their
        parameters changes.
        """
        refusals = [f"The vehicle has no parameter {name}." for name in wanted if name not in parameters]
        refusals += [f"{name} cannot be {value}." for name, value in wanted.items() if not is_single(value)]
        refusals += [
            f"{name} is the firmware's own to keep." for name in wanted if self.rules.is_protected(name)
        ]
        changes = self.in_order(
            tuple(
                Change(name, parameters[name], tidy(value))
                for name, value in wanted.items()
                if name in parameters and not same_value(parameters[name], value)
            )
        )
        if refusals:
            return ParameterPlan(changes, tuple(refusals))
        after = {**parameters, **{c.name: c.new for c in changes}}
        judged = sorted({*touched, *(i for c in changes if (i := self.instance_of(c.name)) is not None)})
        doubts: list[str] = []
        remarks: list[str] = []
        there = self.instances(parameters, reporting)
        for instance in judged:
            if instance not in there:
                doubts.append(self.absent(instance))
                continue
            against, notes = self.judge_compass(parameters, after, instance)
            known = parameter_remarks(self.autopilot, after, instance)
            doubts += [*against, *(remark.text for remark in known if remark.forbids)]
            remarks += [*notes, *(remark.text for remark in known if not remark.forbids)]
            remarks += self.unwatched if changes and not touched else ()
        doubts += self._motor_clash(parameters, after, judged)
        if late := tuple(c.name for c in changes if self.rules.wants_reboot(c.name)):
            takes = "takes" if len(late) == 1 else "take"
            remarks.append(f"{', '.join(late)} {takes} effect after a restart of the autopilot.")
        return ParameterPlan(
            changes,
            refusals=tuple(dict.fromkeys(doubts)) if checked else (),
            remarks=tuple(dict.fromkeys(remarks if checked else doubts + remarks)),
            commit_instances=self.uncommitted(parameters, after, judged),
            after_restart=late,
        )

    def _motor_clash(
        self, before: Mapping[str, float], after: Mapping[str, float], judged: Iterable[int]
    ) -> list[str]:
        """Refuse to change what the motor terms of a compass that is not being written go with."""
        if before.get(self.motor_switch) == after.get(self.motor_switch):
            return []
        held = {self.instance_of(n) for n, v in after.items() if v and re.fullmatch(self.motor_terms, n)}
        return [
            f"{self.motor_switch} is shared: changing it gives compass {other}'s motor terms another meaning."
            for other in sorted({i for i in held if i is not None} - set(judged))
        ]

    def write(self, context: Context, plan: ParameterPlan, save_undo: SaveUndo) -> Script[WriteOutcome]:
        """Write a plan as a transaction; see `vehicle.parameters.transaction`."""
        transaction = Transaction(self.encoding, self.source, self._claimed, self.commit)
        return (yield from transaction.run(context, plan, save_undo))


def numbers(held: Mapping[str, Parameter]) -> dict[str, float]:
    """Return parameters' values without their types."""
    return {name: parameter.value for name, parameter in held.items()}


def no_answer() -> NoReply:
    """Say that a vehicle is there but told nothing about its compasses."""
    return NoReply(
        "The vehicle is alive but answered no question about its compass parameters.",
        "Check that the link carries both ways and that the firmware has a compass; of a recording, that it"
        " begins at power-up (.BIN), or that parameters were read in it (.tlog).",
    )
