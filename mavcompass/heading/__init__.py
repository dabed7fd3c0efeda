"""Heading: level, tilt-compensated, two-axis; from magnetic, true and grid north; with its sigma."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.heading.compute import level_heading as level_heading
    from mavcompass.heading.compute import tilt_compensated_heading as tilt_compensated_heading
    from mavcompass.heading.stream import HeadingResult as HeadingResult
    from mavcompass.heading.stream import earth_field_of as earth_field_of
    from mavcompass.heading.stream import heading_of_track as heading_of_track
    from mavcompass.heading.two_axis import two_axis_heading as two_axis_heading

__getattr__, __dir__ = door(
    __name__,
    {
        "level_heading": "compute",
        "tilt_compensated_heading": "compute",
        "HeadingResult": "stream",
        "earth_field_of": "stream",
        "heading_of_track": "stream",
        "two_axis_heading": "two_axis",
    },
)
