"""Plan writes of PX4's compass parameters: which change, which must not, what to tell."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from mavcompass.compass_parameters import px4_correction, px4_name, px4_rotation, px4_values
from mavcompass.correction import FieldCorrection
from mavcompass.units import MGAUSS_PER_GAUSS
from mavcompass.vehicle.parameters.planning import Judgement, Planner, Wish
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

    instance_of = staticmethod(instance_of)

    def absent(self, instance: int) -> str:
        """Say that there is no such compass."""
        return (
            f"Compass {instance} is not there: {px4_name('ID', instance)} holds no device id. Calibrate it"
            " once with PX4's own routine, which stores the id."
        )

    def wish(self, parameters: Mapping[str, float], instance: int, correction: FieldCorrection) -> Wish:
        """Spell a correction as parameters, less what has the same effect already.

        PX4 subtracts the motors' field before its matrix, so the motor term in force stays right when the
        matrix changes; a new one is not written.
        """
        try:
            rotation, before = px4_rotation(parameters, instance), px4_correction(parameters, instance)
        except KeyError:
            return Wish(refusal=_custom_angle(instance))
        values = {
            name: value
            for name, value in px4_values(correction, instance, rotation).items()
            if not abs(value - parameters.get(name, math.inf)) < _ROUNDING
        }
        return Wish(values, remarks=tuple(_about_motor(instance, before, correction)))

    def judge_compass(
        self, before: Mapping[str, float], after: Mapping[str, float], instance: int
    ) -> Judgement:
        """Check what a compass would hold: reasons against it, and what a person should know."""
        label = f"Compass {instance}"
        try:
            old, new = px4_correction(before, instance), px4_correction(after, instance)
        except KeyError:
            return [_custom_angle(instance)], []
        refusals, remarks = check_correction(new, self.rules, label, self.rules.offset_largest_mgauss)
        for what, moved, smallest in (
            ("offsets", np.subtract(new.offsets_mgauss, old.offsets_mgauss), _SMALLEST_LIVE_CHANGE_MGAUSS),
            ("scales", np.subtract(new.diagonals, old.diagonals), _SMALLEST_LIVE_CHANGE),
            ("cross terms", np.subtract(new.off_diagonals, old.off_diagonals), _SMALLEST_LIVE_CHANGE),
        ):
            if _ROUNDING < float(np.linalg.norm(moved)) <= smallest:
                remarks.append(f"{label}: so small a change of the {what} is taken over at the next start.")
        if after.get(px4_name("PRIO", instance), -1.0) == 0.0:
            remarks.append(f"{label} is switched off ({px4_name('PRIO', instance)} is 0).")
        return refusals, remarks

    def closing_remarks(self, after: Mapping[str, float]) -> list[str]:
        """Say what a person should know of any new calibration."""
        if not after.get("SENS_MAG_AUTOCAL", 0.0):
            return []
        return ["SENS_MAG_AUTOCAL is on: PX4 may go on changing the offsets itself in flight."]


def _custom_angle(instance: int) -> str:
    return f"Compass {instance} is mounted at a custom angle, which its offsets cannot be turned by."


def _about_motor(instance: int, before: FieldCorrection, wanted: FieldCorrection) -> list[str]:
    if wanted.motor_source == "none":
        return []
    raw_before = np.linalg.solve(before.matrix, before.motor_mgauss)
    raw_wanted = np.linalg.solve(wanted.matrix, wanted.motor_mgauss)
    if wanted.motor_source == before.motor_source and np.allclose(
        raw_before, raw_wanted, atol=1e-3 * MGAUSS_PER_GAUSS
    ):
        return []
    return [f"Compass {instance}: the motor term is left as it is; set it with PX4's own compensation."]
