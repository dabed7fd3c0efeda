"""The parameters of a Track's vehicle, as it would tell them."""

from __future__ import annotations

import re
from operator import itemgetter

from mavcompass.compass_parameters import values
from mavcompass.enums import MavParamType
from mavcompass.messages import ParamValue
from mavcompass.procedure.script import Context
from mavcompass.track import Track
from mavcompass.vehicle.parameters.values import Parameter, encode

# A Track does not tell types; these are PX4's whole numbers among the parameters of compasses.
_PX4_WHOLE_NUMBERS = re.compile(r"CAL_MAG\d_(ID|ROT|PRIO)|CAL_MAG_(COMP_TYP|SIDES|ROT_AUTO)|SENS_BOARD_ROT")


def first_parameters(track: Track) -> dict[str, float]:
    """Return the recording's parameters, each compass's correction as it was at the start."""
    held = dict(track.parameters)
    for instance, compass in track.compasses.items():
        known = track.autopilot == "px4" and any(name.startswith("CAL_MAG") for name in held)
        if not known:
            held |= values(track.autopilot, track.parameters, instance, compass.in_force[0].correction)
    return held


def parameter_changes(track: Track) -> list[tuple[float, ParamValue]]:
    """Return the corrections that came into force on the way, as values with their times."""
    changes = []
    for instance, compass in track.compasses.items():
        for before, after in zip(compass.in_force[:-1], compass.in_force[1:], strict=True):
            old, new = (
                values(track.autopilot, track.parameters, instance, step.correction)
                for step in (before, after)
            )
            for name, value in new.items():
                if old.get(name) != value:
                    said = parameter_value(track, name, value, 65_535, len(track.parameters))
                    changes.append((after.from_s, said))
    return sorted(changes, key=itemgetter(0))


def parameter_value(track: Track, name: str, value: float, index: int, count: int) -> ParamValue:
    """Spell a parameter as its autopilot does on the wire."""
    whole = track.autopilot == "px4" and _PX4_WHOLE_NUMBERS.fullmatch(name) is not None
    kind = MavParamType.INT32 if whole else MavParamType.REAL32
    wire = encode(name, Parameter(value, kind), "bytewise" if whole else "cast", Context())
    return ParamValue(name, wire.param_value, kind, count, index)
