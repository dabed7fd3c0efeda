"""Put the vehicle as it was found into a simulator: a file per simulator, and what it cannot hold."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from mavcompass.gap.export.simulators import ardupilot_lua, ardupilot_sitl, gazebo, preset, px4_sitl
from mavcompass.gap.export.vehicle import (
    Exported,
    Found,
    follows_places,
    found_in,
    known_to,
    nominal_settings,
    settings_of,
)

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
    "nominal_settings",
    "settings_of",
]
