"""The dialects, by autopilot: compass parameters read, planned and written, and what goes with them."""

from __future__ import annotations

from mavcompass.errors import Refused
from mavcompass.vehicle.dialects.ardupilot import ArduPilotDialect
from mavcompass.vehicle.dialects.compass import CompassDialect as CompassDialect
from mavcompass.vehicle.dialects.px4 import PX4Dialect

DIALECTS: dict[str, type[CompassDialect]] = {"ardupilot": ArduPilotDialect, "px4": PX4Dialect}


def make_dialect(autopilot: str, source: str = "SOURCE") -> CompassDialect:
    """Make the dialect of "ardupilot" or "px4".

    `source` is the vehicle's address as the person gave it, which goes into the command that restores.
    Raises Refused for any other autopilot: its parameters are not known.
    """
    if autopilot not in DIALECTS:
        raise Refused(
            f"The compass parameters of the autopilot {autopilot!r} are not known.",
            "Connect a vehicle that runs ArduPilot or PX4.",
        )
    return DIALECTS[autopilot](source)
