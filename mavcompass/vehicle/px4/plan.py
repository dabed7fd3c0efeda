"""Plan writes of PX4's compass parameters: which change, which must not, what to tell."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from mavcompass.compass_parameters import px4_correction, px4_name, px4_rotation, px4_values
from mavcompass.correction import FieldCorrection
from mavcompass.procedure.dialect import Change, ParameterPlan
from mavcompass.units import MGAUSS_PER_GAUSS
from mavcompass.vehicle.parameters.rules import ParameterRules, check_correction
from mavcompass.vehicle.parameters.values import is_single, same_value, tidy

# PX4 takes over a change of the offsets during the run only when it is longer than this.
_SMALLEST_LIVE_CHANGE_MGAUSS = 1.0
# Turning a correction into body axes and back leaves this much, in gauss and as a factor.
_ROUNDING = 1e-6


def plan_corrections(
    parameters: Mapping[str, float],
    corrections: Mapping[int, FieldCorrection],
    instances: Iterable[int],
    rules: ParameterRules,
) -> ParameterPlan:
    """Plan the write of new corrections, by instance from 1, over the parameters in force.

    PX4 subtracts the motors' field before its matrix, so the motor term in force stays right when the
    matrix changes; a new one is not written.
    """
    present = tuple(instances)
    wanted: dict[str, float] = {}
    unwritable: list[str] = []
    remarks: list[str] = []
    for instance, correction in sorted(corrections.items()):
        if instance not in present:
            unwritable.append(_absent(instance))
            continue
        numbers = [*correction.offsets_mgauss, *correction.matrix.flat, *correction.motor_mgauss]
        if not np.isfinite(numbers).all():
            unwritable.append(f"Compass {instance}: the correction holds a value that is not a number.")
            continue
        try:
            rotation, before = px4_rotation(parameters, instance), px4_correction(parameters, instance)
        except KeyError:
            unwritable.append(
                f"Compass {instance} is mounted at a custom angle, which its offsets cannot be turned by."
            )
            continue
        for name, value in px4_values(correction, instance, rotation).items():
            if not abs(value - parameters.get(name, math.inf)) < _ROUNDING:
                wanted[name] = value
        remarks += _about_motor(instance, before, correction)
    touched = [instance for instance in corrections if instance in present]
    plan = plan_values(parameters, wanted, present, rules, touched=touched)
    return replace(plan, refusals=(*unwritable, *plan.refusals), remarks=(*plan.remarks, *remarks))


def plan_values(
    parameters: Mapping[str, float],
    wanted: Mapping[str, float],
    instances: Iterable[int],
    rules: ParameterRules,
    checked: bool = True,
    touched: Iterable[int] = (),
) -> ParameterPlan:
    """Plan the write of single parameters; unchecked, what is out of range is only remarked on.

    `touched` are compasses to judge even if none of their parameters changes.
    """
    refusals = [f"The vehicle has no parameter {name}." for name in wanted if name not in parameters]
    refusals += [f"{name} cannot be {value}." for name, value in wanted.items() if not is_single(value)]
    refusals += [f"{name} is the firmware's own to keep." for name in wanted if rules.is_protected(name)]
    changes = tuple(
        Change(name, parameters[name], tidy(value))
        for name, value in wanted.items()
        if name in parameters and not same_value(parameters[name], value)
    )
    if refusals:
        return ParameterPlan(changes, tuple(refusals))
    after = {**parameters, **{c.name: c.new for c in changes}}
    judged = sorted({*touched, *(i for c in changes if (i := instance_of(c.name)) is not None)})
    doubts, remarks = _judge(parameters, after, judged, set(instances), rules)
    remarks += [
        f"{c.name} takes effect after a restart of the autopilot."
        for c in changes
        if rules.wants_reboot(c.name)
    ]
    if changes and judged and after.get("SENS_MAG_AUTOCAL", 0.0):
        remarks.append("SENS_MAG_AUTOCAL is on: PX4 may go on changing the offsets itself in flight.")
    return ParameterPlan(
        changes, tuple(doubts) if checked else (), tuple(remarks if checked else doubts + remarks)
    )


def instance_of(name: str) -> int | None:
    """Tell which compass, from 1, a parameter belongs to; None for one of all compasses.

    >>> instance_of("CAL_MAG0_XOFF"), instance_of("CAL_MAG_COMP_TYP")
    (1, None)
    """
    match = re.fullmatch(r"CAL_MAG([0-3])_\w+", name)
    return int(match[1]) + 1 if match else None


def _judge(
    before: Mapping[str, float],
    after: Mapping[str, float],
    judged: Iterable[int],
    present: set[int],
    rules: ParameterRules,
) -> tuple[list[str], list[str]]:
    """Check what the vehicle would hold: reasons against it, and what a person should know."""
    refusals: list[str] = []
    remarks: list[str] = []
    for instance in judged:
        label = f"Compass {instance}"
        if instance not in present:
            refusals.append(_absent(instance))
            continue
        try:
            old, new = px4_correction(before, instance), px4_correction(after, instance)
        except KeyError:
            refusals.append(f"{label} is mounted at a custom angle, which its offsets cannot be turned by.")
            continue
        doubts, notes = check_correction(new, rules, label, rules.offset_largest_mgauss)
        refusals += doubts
        remarks += notes
        moved_mgauss = float(np.linalg.norm(np.subtract(new.offsets_mgauss, old.offsets_mgauss)))
        if 0.0 < moved_mgauss < _SMALLEST_LIVE_CHANGE_MGAUSS:
            remarks.append(f"{label}: so small a change of the offsets is taken over at the next start.")
        if after.get(px4_name("PRIO", instance), -1.0) == 0.0:
            remarks.append(f"{label} is switched off ({px4_name('PRIO', instance)} is 0).")
    return refusals, remarks


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


def _absent(instance: int) -> str:
    return (
        f"Compass {instance} is not there: {px4_name('ID', instance)} holds no device id. Calibrate it once"
        " with PX4's own routine, which stores the id."
    )
