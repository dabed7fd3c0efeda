"""ArduPilot's dialect: its compass parameters, in both spellings, read, planned and written.

The firmware counts a compass as calibrated when its offsets are not all zero *and* the stored device
id is the detected one. PARAM_SET stores offsets only; the id of a compass that was never calibrated, or
was exchanged, is stored by PREFLIGHT_SET_SENSOR_OFFSETS (which sets the offsets of that one compass,
too) or, where a build lacks this, by PREFLIGHT_CALIBRATION with 76 in its second place (which marks
all detected compasses). Neither tells whether it was needed; the arming checks do.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from mavcompass.calibration.result import OwnFinding
from mavcompass.compass_parameters import (
    PER_MOTOR,
    PER_MOTOR_NAMES,
    ArduPilotNaming,
    ardupilot_angle_names,
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_is_external,
    ardupilot_name,
    ardupilot_naming,
    ardupilot_orientations,
    values,
)
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoReply, Refused
from mavcompass.frames import FloatArray
from mavcompass.messages import Incoming, Statustext
from mavcompass.procedure.commands import command
from mavcompass.procedure.dialect import Change, ParameterPlan
from mavcompass.procedure.script import Context, Script
from mavcompass.steering import ARDUPILOT_COMPASSES
from mavcompass.vehicle.dialects.compass import CompassDialect, Judgement, no_answer, numbers
from mavcompass.vehicle.dialects.own_calibration import calibrate_ardupilot
from mavcompass.vehicle.dialects.taking_over import prompt_ekf3, take_ekf3_yaw
from mavcompass.vehicle.parameters import protocol
from mavcompass.vehicle.parameters.rules import check_correction
from mavcompass.vehicle.parameters.values import Encoding, Parameter, same_value

_SPELLING_PROBES = ("COMPASS_OFS_X", "COMPASS1_OFS_X")
_MATRIX = tuple(f"{stem}_{axis}" for stem in ("DIA", "ODI") for axis in "XYZ")
_OFFSETS = tuple(f"OFS_{axis}" for axis in "XYZ")

# Of the compass, those that a calibration cures; not "not healthy", "calibration running", "requires reboot".
_OF_ITS_CALIBRATION = re.compile(
    r"Check mag field|Compass(?:es)? (?:\d )?not calibrated|Compass offsets too high|Compasses inconsistent"
)
# Seen in its source (4.5.7): one bit of ARMING_CHECK stands for all that the compass is asked
# (`compass_checks`), bit 0 for all checks there are. From 4.7 on ARMING_SKIPCHK names what is not asked.
_ALL, _COMPASS = 1, 1 << 2
# Bits 1 to 20, all that 4.5 to 4.6 know; one that is unknown means nothing.
_EACH = (1 << 21) - 2

_OFFSETS_OF_COMPASS = {1: 2.0, 2: 5.0, 3: 6.0}  # first number of PREFLIGHT_SET_SENSOR_OFFSETS
_FORCE_SAVE = 76.0
_CHECK_TEXTS_S = 1.2


class ArduPilotDialect(CompassDialect):
    """Speak ArduPilot's compass parameters, and plan by its rules."""

    autopilot: Literal["ardupilot"] = "ardupilot"
    prefix = ("COMPASS", "CUST_ROT")
    encoding: Encoding = "cast"
    motor_terms, motor_switch = r"COMPASS[123]?_MOT[23]?_[XYZ]", "COMPASS_MOTCT"
    unwatched = ("The autopilot's own heading follows a new calibration slowly: reboot it before it moves.",)
    restart_wanted_by_own = True

    # --- reading ------------------------------------------------------------------------------------

    def compass_parameters_typed(self, context: Context) -> Script[dict[str, Parameter]]:
        """Read everything about all compasses and what `rules.vehicle` adds, with types.

        The spelling of the names is found by two questions. What each motor has is asked for where in force.
        """
        probes = yield from protocol.read(context, _SPELLING_PROBES, self.encoding, enough=bool)
        if not probes:
            raise no_answer()
        naming = ardupilot_naming(numbers(probes))
        names = [*self.rules.general, *self.rules.vehicle]
        for instance in ARDUPILOT_COMPASSES:
            names += self.instance_names(instance, naming)
        held = yield from self.read_typed(context, names)
        told = numbers(held)
        more = ardupilot_angle_names(told) + (PER_MOTOR_NAMES if told.get(PER_MOTOR) else ())
        return held | (yield from self.read_typed(context, more))

    def instance_names(self, instance: int, naming: ArduPilotNaming) -> tuple[str, ...]:
        """List all parameters of one compass."""
        own = [ardupilot_name(quantity, instance, naming) for quantity in self.rules.per_compass]
        return (*ardupilot_correction_names(instance, naming), *own)

    @staticmethod
    def instance_of(name: str) -> int | None:
        """Tell which compass a parameter belongs to; None for one of all compasses.

        >>> [ArduPilotDialect.instance_of(n) for n in ("COMPASS_OFS2_X", "COMPASS3_DIA_Y", "COMPASS_MOTCT")]
        [2, 3, None]
        """
        if match := re.fullmatch(r"COMPASS([123])_\w+", name):
            return int(match[1])
        if match := re.fullmatch(r"COMPASS_(?:OFS|DIA|ODI|MOT)([23]?)_[XYZ]", name):
            return int(match[1] or 1)
        if name in (PER_MOTOR, *PER_MOTOR_NAMES):
            return 1
        if match := re.fullmatch(r"COMPASS_(?:SCALE|USE|ORIENT|EXTERNAL|EXTERN|DEV_ID)([23]?)", name):
            return int(match[1] or 1)
        return None

    def device_ids(self, parameters: Mapping[str, float]) -> tuple[int, ...]:
        """List the device ids of all compasses that it has room for, 0 where there is none."""
        naming = ardupilot_naming(parameters)
        names = (ardupilot_name("DEV_ID", instance, naming) for instance in ARDUPILOT_COMPASSES)
        return tuple(int(parameters.get(name, 0.0)) for name in names)

    def correction(self, parameters: Mapping[str, float], instance: int) -> FieldCorrection:
        """Return the correction in force."""
        return ardupilot_correction(parameters, instance)

    # --- planning -----------------------------------------------------------------------------------

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
            plain = FieldCorrection.from_matrix(correction.offsets_mgauss, correction.matrix)
            correction = plain.with_motors(correction.motors, correction)
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
        return refusals + more_refusals, remarks + more_remarks

    def uncommitted(
        self, before: Mapping[str, float], after: Mapping[str, float], judged: Iterable[int]
    ) -> tuple[int, ...]:
        """List compasses that were never calibrated: their device id is detected but not yet stored."""
        naming = ardupilot_naming(before)

        def calibrated(values: Mapping[str, float], instance: int) -> bool:
            return any(values.get(ardupilot_name(q, instance, naming), 0.0) for q in _OFFSETS)

        return tuple(i for i in judged if not calibrated(before, i) and calibrated(after, i))

    # --- beside the parameters ----------------------------------------------------------------------

    def commit(self, context: Context, plan: ParameterPlan) -> Script[tuple[str, ...]]:
        """Store the device ids that a written plan needs, and return what a person should know.

        Nothing is stored where the firmware does not ask for it: neither `plan.commit_instances` nor the
        arming checks say so.
        """
        if not any(_offset_stem(change.name) for change in plan.changes):
            return ()
        if not plan.commit_instances and not (yield from _says_not_calibrated(context)):
            return ()
        offsets = yield from _offsets_now(context, plan)
        if not offsets:
            return ()
        context.show("write", "Having the autopilot store the compass's device id.")
        remarks: list[str] = []
        wanted = {i: offsets[i] for i in plan.commit_instances or offsets if i in offsets}
        if not (yield from _store(context, wanted)):
            accepted = yield from _ask(context, MavCmd.PREFLIGHT_CALIBRATION, 0.0, _FORCE_SAVE)
            if accepted:
                remarks.append(
                    "All detected compasses are now marked as calibrated, not only the written one."
                )
            else:
                remarks.append(
                    "The autopilot would not store the compass's device id; if it says 'Compass not"
                    " calibrated', disarm it and write again, or run its own calibration once."
                )
        if (yield from _says_not_calibrated(context)):
            remarks.append(
                "The autopilot still says 'Compass not calibrated': another compass in use is not calibrated,"
                " or it wants a restart."
            )
        return tuple(remarks)

    def arming_exemption(self, context: Context, reasons: Sequence[str]) -> Script[Mapping[str, float]]:
        """Return what leaves the compass out of the arming checks, where these reasons name it alone."""
        if not reasons or not all(_OF_ITS_CALIBRATION.match(reason) for reason in reasons):
            return {}
        held = yield from self.read_parameters(context, ("ARMING_CHECK", "ARMING_SKIPCHK"))
        if "ARMING_SKIPCHK" in held:
            return {"ARMING_SKIPCHK": float(int(held["ARMING_SKIPCHK"]) | _COMPASS)}
        if "ARMING_CHECK" not in held:
            return {}
        asked = int(held["ARMING_CHECK"])
        return {"ARMING_CHECK": float((_EACH if asked & _ALL else asked) & ~_COMPASS)}

    def changed_by_own(self, parameters: Mapping[str, float]) -> tuple[str, ...]:
        """List the one that it sets: learning ends with a calibration."""
        return tuple(name for name in ("COMPASS_LEARN",) if parameters.get(name))

    def calibrate_itself(
        self, context: Context, parameters: Mapping[str, float], instances: tuple[int, ...]
    ) -> Script[Mapping[int, OwnFinding]]:
        """Have it calibrate without saving; see `own_calibration`."""
        return (yield from calibrate_ardupilot(context, instances))

    def prompt_estimator(self, parameters: Mapping[str, float], flying: bool) -> Mapping[str, float]:
        """Return at what EKF3 follows its compass; see `taking_over`."""
        return prompt_ekf3(parameters, flying)

    def take_compass_yaw(
        self, context: Context, parameters: Mapping[str, float], flying: bool
    ) -> Script[str]:
        """Have EKF3 take its compass's yaw over; see `taking_over`."""
        return (yield from take_ekf3_yaw(context, parameters, flying))


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


def _store(context: Context, wanted: Mapping[int, Sequence[float]]) -> Script[bool]:
    for instance, offset in wanted.items():
        number = _OFFSETS_OF_COMPASS[instance]
        if not (yield from _ask(context, MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS, number, *offset)):
            return False
    return True


def _ask(context: Context, number: MavCmd, *params: float) -> Script[bool]:
    try:
        return (yield from command(context, number, *params)) == MavResult.ACCEPTED
    except NoReply:
        return False


def _says_not_calibrated(context: Context) -> Script[bool | None]:
    """Run the arming checks and listen; None where they cannot be run (armed, or unknown to the build)."""
    heard: list[str] = []

    def note(incoming: Incoming) -> None:
        if isinstance(incoming.message, Statustext):
            heard.append(incoming.message.text.lower())

    context.listeners.append(note)
    try:
        try:
            result = yield from command(context, MavCmd.RUN_PREARM_CHECKS, tries=2)
        except NoReply:
            return None
        if result != MavResult.ACCEPTED:
            return None
        end = context.now + _CHECK_TEXTS_S
        while context.now < end:
            yield end
    finally:
        context.listeners.remove(note)
    return any("compass not calibrated" in text for text in heard)


def _offsets_now(context: Context, plan: ParameterPlan) -> Script[dict[int, tuple[float, ...]]]:
    """Read the offsets, by compass, of which the plan wrote some; those that are all zero are left out."""
    offsets: dict[int, tuple[float, ...]] = {}
    for change in plan.changes:
        instance, stem = ArduPilotDialect.instance_of(change.name), _offset_stem(change.name)
        if instance is None or instance in offsets or not stem:
            continue
        names = [stem + axis for axis in "XYZ"]
        held = yield from protocol.read(context, names, "cast", exist=True)
        if len(held) == len(names) and any(held[name].value for name in names):
            offsets[instance] = tuple(held[name].value for name in names)
    return offsets


def _offset_stem(name: str) -> str:
    """Return an offset's name without its axis; empty for any other parameter."""
    return name[:-1] if ArduPilotDialect.instance_of(name) is not None and "OFS" in name else ""
