"""PX4's dialect: CAL_MAGn_*, in gauss, subtracted, in the sensor's own axes, integers bit for bit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.compass_parameters import (
    PX4_ANGLES,
    PX4_CUSTOM,
    PX4_ORIENTATIONS,
    px4_correction,
    px4_name,
    px4_sensor_correction,
    px4_sensor_to_body,
    values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.frames import FloatArray
from mavcompass.procedure.dialect import Change
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.steering import PX4_COMPASSES
from mavcompass.vehicle.dialects.compass import CompassDialect, Judgement, no_answer, numbers
from mavcompass.vehicle.dialects.own_calibration import calibrate_px4
from mavcompass.vehicle.dialects.taking_over import load_px4, prompt_ekf2
from mavcompass.vehicle.parameters.rules import check_correction
from mavcompass.vehicle.parameters.values import Encoding, Parameter

# Turning a correction into body axes and back leaves this much, in gauss and as a factor.
_ROUNDING = 1e-6
# Seen in its source and on it (August 2024): COM_ARM_MAG_ANG is how far apart compasses may point (-1: not
# asked). A field of another strength or dip is not used by the estimator (EKF2_MAG_CHECK), which then has no
# yaw and no place, whatever COM_ARM_MAG_STR says. That a compass has no calibration at all, or that the
# heading is not stable, no parameter sets aside.
_SETS_ASIDE = (
    (re.compile(r"Compass(?:es)? .*inconsistent"), {"COM_ARM_MAG_ANG": -1.0}),
    (re.compile(r"Strong magnetic interference"), {"EKF2_MAG_CHECK": 0.0}),
)


class PX4Dialect(CompassDialect):
    """Speak PX4's compass parameters, and plan by its rules."""

    autopilot: Literal["px4"] = "px4"
    prefix = ("CAL_MAG",)
    encoding: Encoding = "bytewise"
    motor_terms, motor_switch = r"CAL_MAG\d_[XYZ]COMP", "CAL_MAG_COMP_TYP"
    loads_disarmed = True

    # --- reading ------------------------------------------------------------------------------------

    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses, with types; unused slots are not asked for further."""
        names = [
            *self.rules.general,
            *self.rules.vehicle,
            *(px4_name("ID", instance) for instance in PX4_COMPASSES),
        ]
        held = yield from self.read_typed(context, names)
        if not held:
            raise no_answer()
        present = self.instances(numbers(held))
        rest = [px4_name(quantity, i) for i in present for quantity in self.rules.per_compass]
        return held | (yield from self.read_typed(context, [name for name in rest if name not in held]))

    @staticmethod
    def instance_of(name: str) -> int | None:
        """Tell which compass, from 1, a parameter belongs to; None for one of all compasses.

        >>> PX4Dialect.instance_of("CAL_MAG0_XOFF"), PX4Dialect.instance_of("CAL_MAG_COMP_TYP")
        (1, None)
        """
        match = re.fullmatch(r"CAL_MAG([0-3])_\w+", name)
        return int(match[1]) + 1 if match else None

    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""
        return tuple(int(parameters.get(px4_name("ID", instance), 0.0)) for instance in PX4_COMPASSES)

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force, in body axes."""
        return px4_correction(parameters, instance)

    def raw_rotation(self, parameters: Mapping[str, float], instance: int) -> FloatArray | None:
        """Return how the sensor is mounted: SCALED_IMU carries its readings as they are."""
        return px4_sensor_to_body(parameters, instance)

    # --- planning -----------------------------------------------------------------------------------

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
        new = px4_sensor_correction(after, instance)
        refusals, remarks = check_correction(
            new, self.rules, f"Compass {instance}", self.rules.offset_largest_mgauss
        )
        return refusals + _about_mounting(before, after, instance), remarks

    # --- beside the parameters ----------------------------------------------------------------------

    def arming_exemption(self, context: Context, reasons: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return what leaves the compass out of the arming checks."""
        wanted: dict[str, float] = {}
        for reason in reasons:
            cures = [cure for pattern, cure in _SETS_ASIDE if pattern.match(reason)]
            if not cures:
                return {}
            wanted |= cures[0]
        return (yield from nothing(wanted))

    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List all that it holds of compasses: it calibrates every one, and stores it at once."""
        return tuple(name for name in parameters if name.startswith(self.prefix))

    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have it calibrate, and read what it stored; see `own_calibration`."""
        why = yield from calibrate_px4(context)
        if why:
            return {instance: OwnFinding(why_not=why) for instance in instances}
        stored = yield from self.read_parameters(context, self.changed_by_own(parameters))
        found = {}
        for i in instances:
            turned = px4_name("ROT", i)
            found[i] = OwnFinding(px4_correction({**parameters, **stored}, i))
            if stored.get(turned) != parameters.get(turned):
                why = f"PX4 finds it mounted as {turned} {stored[turned]:g}: set that and calibrate again."
                found[i] = OwnFinding(why_not=why)
        return found

    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return at what EKF2 follows its compass on the ground; see `taking_over`."""
        return {} if flying else prompt_ekf2(parameters)

    def load_written(self, context: Context, written: Mapping[str, float]) -> Script[str]:
        """Have PX4 load its calibration, which resets the heading; see `taking_over`."""
        return (yield from load_px4(context, written))


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
