"""Heading: level, tilt-compensated, two-axis; from magnetic, true and grid north; with its sigma."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.earth_field import earth_field_of as earth_field_of
    from mavcompass.heading.compute import level_heading as level_heading
    from mavcompass.heading.compute import tilt_compensated_heading as tilt_compensated_heading
    from mavcompass.heading.compute import two_axis_heading as two_axis_heading
    from mavcompass.heading.evidence import heading_of_track as heading_of_track
    from mavcompass.heading.one_compass import HeadingResult as HeadingResult

__getattr__, __dir__ = door(
    __name__,
    {
        "level_heading": "compute",
        "tilt_compensated_heading": "compute",
        "HeadingResult": "one_compass",
        "earth_field_of": "evidence",
        "heading_of_track": "evidence",
        "two_axis_heading": "compute",
    },
)
