"""Put the vehicle as it was found into a simulator: a file per simulator, and what it cannot hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import MappingProxyType

from mavcompass.gap.export.simulators import ardupilot_lua, ardupilot_sitl, gazebo, preset, px4_sitl
from mavcompass.gap.export.vehicle import (
    Exported,
    Found,
    follows_places,
    known_to,
    left_of_the_place,
    nominal_settings,
    settings_of,
    vehicle_settings,
)
from mavcompass.gap.result import Diagnosis

TARGETS: MappingProxyType[str, Callable[[Found], Exported]] = MappingProxyType(
    {
        "ardupilot-lua": ardupilot_lua,
        "ardupilot-sitl": ardupilot_sitl,
        "gazebo": gazebo,
        "mavcompass": preset,
        "px4-sitl": px4_sitl,
    }
)
__all__ = [
    "TARGETS",
    "Exported",
    "Found",
    "follows_places",
    "found_in",
    "known_to",
    "left_of_the_place",
    "nominal_settings",
    "settings_of",
    "vehicle_settings",
]


def found_in(diagnosis: Diagnosis, source: str, beside_simulator: bool = False) -> Found:
    """Collect the whole vehicle of a diagnosis, what each of its causes costs in heading, and its share.

    `beside_simulator` says that the baseline was the simulator that is to have it.
    """
    costs = {cause.effect: cause.removes_deg for cause in diagnosis.causes}
    gap = diagnosis.field.nominal**2 - diagnosis.field.floor**2
    # What scatters has no bar in the waterfall: it removes its own variance.
    parts = {cause.effect: cause.removes_mgauss**2 for cause in diagnosis.causes}
    parts |= {bar.effect: bar.part_mgauss2 for bar in diagnosis.waterfall}
    shares = {effect: part / gap for effect, part in parts.items()} if gap > 0.0 else {}
    settings = vehicle_settings(diagnosis, beside_simulator)
    known = tuple(known_to(cause) for cause in diagnosis.causes if cause.ci95)
    left2 = left_of_the_place(diagnosis)
    shrink = diagnosis.field.shrink - (left2 / gap if gap > 0.0 else 0.0)
    return Found(settings, source, costs, shrink, shares, known, math.sqrt(left2))
