"""Heading: level, tilt-compensated, two-axis; from magnetic, true and grid north; with its sigma."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavcompass.heading.compute import level_heading as level_heading
    from mavcompass.heading.compute import tilt_compensated_heading as tilt_compensated_heading
    from mavcompass.heading.stream import HeadingResult as HeadingResult
    from mavcompass.heading.stream import earth_field_of as earth_field_of
    from mavcompass.heading.stream import heading_of_track as heading_of_track
    from mavcompass.heading.two_axis import two_axis_heading as two_axis_heading

_PUBLIC = {
    "level_heading": "compute",
    "tilt_compensated_heading": "compute",
    "HeadingResult": "stream",
    "earth_field_of": "stream",
    "heading_of_track": "stream",
    "two_axis_heading": "two_axis",
}


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted(_PUBLIC)
