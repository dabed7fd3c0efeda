"""Plan writes of compass parameters: which change, which must not, what to tell."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.frames import FloatArray
from mavcompass.parameter_remarks import parameter_remarks
from mavcompass.procedure.dialect import NOT_TURNED, Change, ParameterPlan
from mavcompass.vehicle.parameters.rules import ParameterRules
from mavcompass.vehicle.parameters.values import is_single, same_value, tidy

# Reasons against a write, and what a person should know of it.
Judgement = tuple[list[str], list[str]]


class Planner(ABC):
    """Plan by one autopilot's rules; a subclass knows its parameters.

    Attributes:
        autopilot: its name.
        motor_terms: the names of motor terms, a pattern. motor_switch: what says with which load all go.
        unwatched: what to know of single values written by hand, where nobody sees what the autopilot makes
            of them; a calibration watches its heading.
    """

    autopilot: str
    motor_terms: str
    motor_switch: str
    unwatched = ""

    def __init__(self, rules: ParameterRules) -> None:
        self.rules = rules

    @abstractmethod
    def instance_of(self, name: str) -> int | None:
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

    def in_order(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """Put changes in the order of writing, which is undone from its end."""
        return changes

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

    def uncommitted(
        self, before: Mapping[str, float], after: Mapping[str, float], judged: Iterable[int]
    ) -> tuple[int, ...]:
        """List compasses whose device id must be committed beside the parameters."""
        return ()

    def plan(
        self,
        parameters: Mapping[str, float],
        corrections: Mapping[int, FieldCorrection],
        present: Iterable[int],
        turned: Mapping[int, FloatArray] = NOT_TURNED,
    ) -> ParameterPlan:
        """Plan the write of new corrections and mountings, by instance from 1, over the parameters in force.

        What has the same effect as before is left alone.
        """
        present = tuple(present)
        wanted: dict[str, float] = {}
        unwritable: list[str] = []
        for instance, correction in sorted(corrections.items()):
            if instance not in present:
                unwritable.append(self.absent(instance))
            elif not _finite(correction):
                unwritable.append(f"Compass {instance}: the correction holds a value that is not a number.")
            else:
                held = {**parameters, **wanted}  # where another compass has just taken a set of free angles
                try:
                    wanted |= self.wish(held, instance, correction, turned.get(instance))
                except Refused as refusal:
                    unwritable.append(str(refusal))
        touched = [instance for instance in corrections if instance in present]
        plan = self.plan_values(parameters, wanted, present, touched=touched)
        return replace(plan, refusals=(*unwritable, *plan.refusals))

    def plan_values(
        self,
        parameters: Mapping[str, float],
        wanted: Mapping[str, float],
        present: Iterable[int],
        checked: bool = True,
        touched: Iterable[int] = (),
    ) -> ParameterPlan:
        """Plan the write of single parameters; unchecked, what is out of range is only remarked on.

        `present` are the compasses that the vehicle has; `touched` are compasses to judge even if none of
        their parameters changes.
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
        there = set(present)
        for instance in judged:
            if instance not in there:
                doubts.append(self.absent(instance))
                continue
            against, notes = self.judge_compass(parameters, after, instance)
            known = parameter_remarks(self.autopilot, after, instance)
            doubts += [*against, *(remark.text for remark in known if remark.forbids)]
            remarks += [*notes, *(remark.text for remark in known if not remark.forbids)]
        doubts += self._motor_clash(parameters, after, judged)
        if late := tuple(c.name for c in changes if self.rules.wants_reboot(c.name)):
            takes = "takes" if len(late) == 1 else "take"
            remarks.append(f"{', '.join(late)} {takes} effect after a restart of the autopilot.")
        if changes and judged and not touched:
            remarks += [self.unwatched] if self.unwatched else []
        return ParameterPlan(
            changes,
            refusals=tuple(dict.fromkeys(doubts)) if checked else (),
            remarks=tuple(dict.fromkeys(remarks if checked else doubts + remarks)),
            commit_instances=self.uncommitted(parameters, after, judged),
            after_restart=late,
        )


def _finite(correction: FieldCorrection) -> bool:
    numbers = [*correction.offsets_mgauss, *correction.matrix.flat, *correction.motor_mgauss]
    return bool(np.isfinite(numbers).all())
