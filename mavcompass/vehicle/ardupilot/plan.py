"""Plan writes of ArduPilot's compass parameters: which change, which must not, what to tell."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from mavcompass.compass_parameters import (
    ardupilot_correction,
    ardupilot_is_external,
    ardupilot_name,
    ardupilot_naming,
    ardupilot_orientations,
    values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import Change
from mavcompass.vehicle.parameters.planning import Judgement, Planner
from mavcompass.vehicle.parameters.rules import check_correction
from mavcompass.vehicle.parameters.values import same_value

_MATRIX = tuple(f"{stem}_{axis}" for stem in ("DIA", "ODI") for axis in "XYZ")
_OFFSETS = tuple(f"OFS_{axis}" for axis in "XYZ")


def instance_of(name: str) -> int | None:
    """Tell which compass a parameter belongs to; None for one of all compasses.

    >>> instance_of("COMPASS_OFS2_X"), instance_of("COMPASS3_DIA_Y"), instance_of("COMPASS_MOTCT")
    (2, 3, None)
    """
    if match := re.fullmatch(r"COMPASS([123])_\w+", name):
        return int(match[1])
    if match := re.fullmatch(r"COMPASS_(?:OFS|DIA|ODI|MOT)([23]?)_[XYZ]", name):
        return int(match[1] or 1)
    if match := re.fullmatch(r"COMPASS_(?:SCALE|USE|ORIENT|EXTERNAL|EXTERN|DEV_ID)([23]?)", name):
        return int(match[1] or 1)
    return None


class ArduPilotPlanner(Planner):
    """Plan by ArduPilot's rules."""

    autopilot = "ardupilot"
    motor_terms, motor_switch = r"COMPASS[123]?_MOT[23]?_[XYZ]", "COMPASS_MOTCT"
    instance_of = staticmethod(instance_of)
    unwatched = "The autopilot's own heading follows a new calibration slowly: reboot it before it moves."

    def absent(self, instance: int) -> str:
        """Say that there is no such compass."""
        return f"Compass {instance} is not there: the firmware has detected no such sensor."

    def wish(
        self,
        parameters: Mapping[str, float],
        instance: int,
        correction: FieldCorrection,
        turned: FloatArray | None,
    ) -> dict[str, float]:
        """Spell a correction as parameters, less what has the same effect already.

        An all-zero DIA is no matrix, a SCALE out of its limits is 1; the motor term of a correction that
        has none is left alone.
        """
        if correction.scale == 0.0:  # which as a parameter means: no scale
            raise Refused(f"Compass {instance}: a scale of zero would leave no field.")
        naming = ardupilot_naming(parameters)
        in_force = ardupilot_correction(parameters, instance)
        scale_name = ardupilot_name("SCALE", instance, naming)
        if scale_name not in parameters:  # firmware before 4.0: the matrix carries it
            correction = FieldCorrection.from_matrix(
                correction.offsets_mgauss,
                correction.matrix,
                motor_mgauss=correction.motor_mgauss,
                motor_source=correction.motor_source,
            )
        wanted = values("ardupilot", parameters, instance, correction, turned)
        zero = all(same_value(value, 0.0) for value in correction.offsets_mgauss)
        if zero and self.rules.offset_instead_of_zero_mgauss:
            wanted[ardupilot_name("OFS_X", instance, naming)] = self.rules.offset_instead_of_zero_mgauss
        matrix, before = ((*c.diagonals, *c.off_diagonals) for c in (correction, in_force))
        if all(same_value(new, old) for new, old in zip(matrix, before, strict=True)):
            for quantity in _MATRIX:
                del wanted[ardupilot_name(quantity, instance, naming)]
        if same_value(correction.scale, in_force.scale) or scale_name not in parameters:
            del wanted[scale_name]
        return wanted

    def in_order(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """Put the offsets last: what EKF3 has learnt of a compass it forgets when they change, not before."""
        return tuple(sorted(changes, key=lambda change: "OFS" in change.name))

    def judge_compass(
        self, before: Mapping[str, float], after: Mapping[str, float], instance: int
    ) -> Judgement:
        """Check what a compass would hold: reasons against it, and what a person should know."""
        label, naming, rules = f"Compass {instance}", ardupilot_naming(after), self.rules
        largest_mgauss = after.get("COMPASS_OFFS_MAX", 0.0) or rules.offset_largest_mgauss
        refusals, remarks = check_correction(
            ardupilot_correction(after, instance), rules, label, largest_mgauss
        )
        scale = after.get(ardupilot_name("SCALE", instance, naming), 0.0)
        if scale and rules.scale is not None and not rules.scale[0] <= scale <= rules.scale[1]:
            refusals.append(
                f"{label}: the firmware ignores a scale of {scale:g}, outside {rules.scale[0]:.3g} to"
                f" {rules.scale[1]:g}."
            )
        if not any(after.get(ardupilot_name(q, instance, naming), 0.0) for q in _OFFSETS):
            refusals.append(f"{label}: offsets of exactly zero mean 'not calibrated' to the firmware.")
        more_refusals, more_remarks = _about_mounting(before, after, instance)
        refusals, remarks = refusals + more_refusals, remarks + more_remarks
        return refusals, remarks

    def uncommitted(
        self, before: Mapping[str, float], after: Mapping[str, float], judged: Iterable[int]
    ) -> tuple[int, ...]:
        """List compasses that were never calibrated: their device id is detected but not yet stored."""
        naming = ardupilot_naming(before)

        def calibrated(values: Mapping[str, float], instance: int) -> bool:
            return any(values.get(ardupilot_name(q, instance, naming), 0.0) for q in _OFFSETS)

        return tuple(i for i in judged if not calibrated(before, i) and calibrated(after, i))


def _about_mounting(before: Mapping[str, float], after: Mapping[str, float], instance: int) -> Judgement:
    naming = ardupilot_naming(after)
    orient = ardupilot_name("ORIENT", instance, naming)
    if same_value(before.get(orient, 0.0), after.get(orient, 0.0)):
        return [], []
    if not ardupilot_is_external(after, instance):
        return [], [f"{orient} does nothing: compass {instance} is inside the flight controller."]
    if after[orient] not in ardupilot_orientations(after):
        return [f"{orient} {after[orient]:g} is no rotation that this firmware knows: it would not arm."], []
    offsets = [ardupilot_name(q, instance, naming) for q in _OFFSETS]
    if any(after.get(name) != before.get(name) for name in offsets):
        return [], []
    return [], [
        f"Compass {instance} is turned and keeps its offsets, which are in the vehicle's axes: calibrate it."
    ]
