"""What a person should know of a vehicle's compass parameters, beside the correction that they hold.

One function, whichever way the parameters came: read off a live vehicle or out of a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from mavcompass.compass_parameters import ardupilot_name, ardupilot_naming, px4_name
from mavcompass.printable import named
from mavcompass.steering import ARDUPILOT_COMPASSES, LEARN_INFLIGHT, PX4_COMPASSES, yaw_elsewhere
from mavcompass.units import DEG_PER_RAD

_SAID_OTHERWISE = ("COMPASS_ENABLE", "COMPASS_LEARN")


@dataclass(frozen=True, slots=True)
class Remark:
    """Hold a sentence or two; `forbids` where nothing must be written before it is mended."""

    text: str
    forbids: bool = False


def parameter_remarks(autopilot: str, parameters: Mapping[str, float], instance: int) -> list[Remark]:
    """List what to know of one compass (from 1) that the vehicle has; other than PX4 counts as ArduPilot.

    Parameters that are absent count as their default.
    """
    remarks = _px4 if autopilot == "px4" else _ardupilot
    return [*_steering(autopilot, parameters), *remarks(parameters, instance)]


def remarks_said(autopilot: str, parameters: Mapping[str, float], *instances: int) -> tuple[str, ...]:
    """Return the sentences of `parameter_remarks` for some compasses, each once."""
    said = (remark.text for i in instances for remark in parameter_remarks(autopilot, parameters, i))
    return tuple(dict.fromkeys(said))


def _steering(autopilot: str, parameters: Mapping[str, float]) -> list[Remark]:
    elsewhere = yaw_elsewhere(autopilot, parameters)
    if elsewhere is None or elsewhere[1] in _SAID_OTHERWISE:
        return []
    source, name = elsewhere
    what = "from the satellite receivers" if source == "gps" else "from elsewhere"
    return [
        Remark(f"The autopilot takes its yaw {what} ({name} is {parameters[name]:g}): no compass steers.")
    ]


def _ardupilot(parameters: Mapping[str, float], instance: int) -> list[Remark]:
    naming, remarks = ardupilot_naming(parameters), []

    def id_name(of: int) -> str:
        return ardupilot_name("DEV_ID", of, naming)

    if parameters.get("COMPASS_ENABLE") == 0.0:
        text = "The compass is switched off: set COMPASS_ENABLE to 1 and restart the autopilot."
        remarks.append(Remark(text, forbids=True))
    learn = parameters.get("COMPASS_LEARN", 0.0)
    if learn == LEARN_INFLIGHT:
        text = "COMPASS_LEARN is 3: in-flight learning would overwrite the offsets. Set it to 0."
        remarks.append(Remark(text, forbids=True))
    elif learn:
        text = f"COMPASS_LEARN is {learn:g}: the firmware will go on changing the offsets itself."
        remarks.append(Remark(text))
    if parameters.get(use := ardupilot_name("USE", instance, naming)) == 0.0:
        remarks.append(Remark(f"Compass {instance} is not used for the heading ({use} is 0)."))
    ids = {i: parameters[id_name(i)] for i in ARDUPILOT_COMPASSES if id_name(i) in parameters}
    detected, first_choice = ids.get(instance), parameters.get(f"COMPASS_PRIO{instance}_ID", 0.0)
    if detected == 0.0:
        remarks.append(
            Remark(
                f"{id_name(instance)} is 0 although compass {instance} is there: this firmware tells no id of"
                " it. One that does will call it uncalibrated until it is calibrated again."
            )
        )
    elif detected and first_choice and detected != first_choice:
        other = next((i for i, known in ids.items() if known == first_choice), None)
        remarks.append(Remark(_about_priority(instance, other)))
    remarks += _same_id(ids, instance, id_name)
    if parameters.get("COMPASS_AUTODEC") == 0.0:
        declination_deg = parameters.get("COMPASS_DEC", 0.0) * DEG_PER_RAD
        text = (
            f"COMPASS_AUTODEC is 0: the autopilot adds a declination of {declination_deg:.1f} deg set by"
            " hand; see that it is right for this place."
        )
        remarks.append(Remark(text))
    return remarks


def _about_priority(instance: int, other: int | None) -> str:
    if other is None:
        return (
            f"COMPASS_PRIO{instance}_ID names a sensor that was not found: the firmware will not arm"
            " without it. Connect it, or set COMPASS_PRIO1_ID to COMPASS_PRIO3_ID to 0 and restart."
        )
    return (
        f"COMPASS_PRIO{instance}_ID names another sensor than the one in use, compass {other}'s: after the"
        " next start the compasses change places, their calibrations with them. Restart the autopilot, and"
        " calibrate then."
    )


def _same_id(ids: Mapping[int, float], instance: int, name: Callable[[int], str]) -> list[Remark]:
    """Remark on a sensor's id that stands for several compasses (ArduPilot issues 5923 and 18887)."""
    mine = ids.get(instance)
    alike = [i for i, known in ids.items() if known == mine]
    if not mine or len(alike) < 2:
        return []
    text = (
        f"{named([f'compass {i}' for i in alike]).capitalize()} have the same device id"
        f" ({' and '.join(name(i) for i in alike)} are {mine:.0f}): the firmware cannot tell which"
        " calibration is whose. Give each its own address or node number."
    )
    return [Remark(text)]


def _px4(parameters: Mapping[str, float], instance: int) -> list[Remark]:
    remarks, id_name = [], px4_name("ID", instance)
    if parameters.get(priority := px4_name("PRIO", instance)) == 0.0:
        remarks.append(Remark(f"Compass {instance} is switched off ({priority} is 0)."))
    ids = {i: parameters[px4_name("ID", i)] for i in PX4_COMPASSES if px4_name("ID", i) in parameters}
    if ids.get(instance) == 0.0:
        text = (
            f"{id_name} is 0: PX4 holds no calibration of compass {instance}. Calibrate it once with PX4's"
            " own routine, which stores the id."
        )
        remarks.append(Remark(text))
    return remarks + _same_id(ids, instance, partial(px4_name, "ID"))
