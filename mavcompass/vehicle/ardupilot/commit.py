"""Make ArduPilot store a compass's device id, without which written offsets are "not calibrated".

The firmware counts a compass as calibrated when its offsets are not all zero *and* the stored device
id is the detected one. PARAM_SET stores offsets only; the id of a compass that was never calibrated, or
was exchanged, is stored by PREFLIGHT_SET_SENSOR_OFFSETS (which sets the offsets of that one compass,
too) or, where a build lacks this, by PREFLIGHT_CALIBRATION with 76 in its second place (which marks
all detected compasses). Neither tells whether it was needed; the arming checks do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoReply
from mavcompass.messages import Incoming, Statustext
from mavcompass.procedure.commands import command
from mavcompass.procedure.dialect import ParameterPlan
from mavcompass.procedure.script import Context, Script
from mavcompass.vehicle.ardupilot.plan import instance_of
from mavcompass.vehicle.parameters import protocol

_OFFSETS_OF_COMPASS = {1: 2.0, 2: 5.0, 3: 6.0}  # first number of PREFLIGHT_SET_SENSOR_OFFSETS
_FORCE_SAVE = 76.0
_CHECK_TEXTS_S = 1.2


def commit_device_ids(context: Context, plan: ParameterPlan) -> Script[tuple[str, ...]]:
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
            remarks.append("All detected compasses are now marked as calibrated, not only the written one.")
        else:
            remarks.append(
                "The autopilot would not store the compass's device id; if it says 'Compass not calibrated',"
                " disarm it and write again, or run its own calibration once."
            )
    if (yield from _says_not_calibrated(context)):
        remarks.append(
            "The autopilot still says 'Compass not calibrated': another compass in use is not calibrated,"
            " or it wants a restart."
        )
    return tuple(remarks)


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
        instance, stem = instance_of(change.name), _offset_stem(change.name)
        if instance is None or instance in offsets or not stem:
            continue
        names = [stem + axis for axis in "XYZ"]
        held = yield from protocol.read(context, names, "cast", exist=True)
        if len(held) == len(names) and any(held[name].value for name in names):
            offsets[instance] = tuple(held[name].value for name in names)
    return offsets


def _offset_stem(name: str) -> str:
    """Return an offset's name without its axis; empty for any other parameter."""
    return name[:-1] if instance_of(name) is not None and "OFS" in name else ""
