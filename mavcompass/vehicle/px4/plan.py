"""Plan writes of PX4's compass parameters: which change, which must not, what to tell."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from mavcompass.compass_parameters import (
    PX4_ANGLES,
    PX4_CUSTOM,
    PX4_ORIENTATIONS,
    px4_name,
    px4_sensor_correction,
    values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import Change
from mavcompass.vehicle.parameters.planning import Judgement, Planner
from mavcompass.vehicle.parameters.rules import check_correction

# PX4 loads a change of the offsets, of the diagonal, of the rest during the run only where it is longer.
_SMALLEST_LIVE_CHANGE_MGAUSS, _SMALLEST_LIVE_CHANGE = 5.0, 0.01
# Turning a correction into body axes and back leaves this much, in gauss and as a factor.
_ROUNDING = 1e-6


def instance_of(name: str) -> int | None:
    """Tell which compass, from 1, a parameter belongs to; None for one of all compasses.

    >>> instance_of("CAL_MAG0_XOFF"), instance_of("CAL_MAG_COMP_TYP")
    (1, None)
    """
    match = re.fullmatch(r"CAL_MAG([0-3])_\w+", name)
    return int(match[1]) + 1 if match else None


class PX4Planner(Planner):
    """Plan by PX4's rules."""

    autopilot = "px4"
    motor_terms, motor_switch = r"CAL_MAG\d_[XYZ]COMP", "CAL_MAG_COMP_TYP"
    instance_of = staticmethod(instance_of)

    def absent(self, instance: int) -> str:
        """Say that there is no such compass."""
        return (
            f"Compass {instance} is not there: {px4_name('ID', instance)} holds no device id. Calibrate it"
            " once with PX4's own routine, which stores the id."
        )

    def wish(
        self,
        parameters: Mapping[str, float],
        instance: int,
        correction: FieldCorrection,
        turned: FloatArray | None,
    ) -> dict[str, float]:
        """Spell a correction as parameters, less what has the same effect already."""
        if not parameters.get(px4_name("ID", instance)):
            raise Refused(self.absent(instance))
        spelled = values("px4", parameters, instance, correction, turned)
        return {
            name: value
            for name, value in spelled.items()
            if not abs(value - parameters.get(name, math.inf)) < _ROUNDING
        }

    def in_order(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """Put ROT before the angles where it becomes 100, and behind them otherwise.

        While an angle is not zero PX4 makes ROT 100. From its end, a plan is undone in the right order too.
        """

        def place(change: Change) -> int:
            return 0 if not change.name.endswith("_ROT") else -1 if change.new == PX4_CUSTOM else 1

        return tuple(sorted(changes, key=place))

    def judge_compass(
        self, before: Mapping[str, float], after: Mapping[str, float], instance: int
    ) -> Judgement:
        """Check what a compass would hold: reasons against it, and what a person should know."""
        label = f"Compass {instance}"
        old, new = px4_sensor_correction(before, instance), px4_sensor_correction(after, instance)
        refusals, remarks = check_correction(new, self.rules, label, self.rules.offset_largest_mgauss)
        refusals += _about_mounting(before, after, instance)
        for what, moved, smallest in (
            ("offsets", np.subtract(new.offsets_mgauss, old.offsets_mgauss), _SMALLEST_LIVE_CHANGE_MGAUSS),
            ("scales", np.subtract(new.diagonals, old.diagonals), _SMALLEST_LIVE_CHANGE),
            ("cross terms", np.subtract(new.off_diagonals, old.off_diagonals), _SMALLEST_LIVE_CHANGE),
        ):
            if _ROUNDING < float(np.linalg.norm(moved)) <= smallest:
                remarks.append(f"{label}: the small change of the {what} takes effect at the next start.")
        return refusals, remarks


def _about_mounting(before: Mapping[str, float], after: Mapping[str, float], instance: int) -> list[str]:
    rot, *angles = (px4_name(quantity, instance) for quantity in ("ROT", *PX4_ANGLES))
    number = after.get(rot, -1.0)
    if all(after.get(name) == before.get(name) for name in (rot, *angles)):
        return []
    if number not in (-1, *PX4_ORIENTATIONS) and not (number == PX4_CUSTOM and angles[0] in after):
        return [f"{rot} {number:g} is no rotation that this PX4 knows: it would take it for 0."]
    if number not in (-1, PX4_CUSTOM) and any(after.get(name, 0.0) for name in angles):
        return [f"{rot} cannot be {number:g} beside angles other than 0: PX4 would make it {PX4_CUSTOM}."]
    return []
