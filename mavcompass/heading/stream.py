"""The heading of a recording, sample by sample, with what is not known of it."""

from __future__ import annotations

from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import earth_field_of as earth_field_of
from mavcompass.heading.evidence import CompassHeading, compare, compass_heading, other_compasses
from mavcompass.heading.fault_isolation import isolate_faults
from mavcompass.heading.one_compass import UNKNOWN_YEAR, heading_by_compass
from mavcompass.heading.one_compass import HeadingResult as HeadingResult
from mavcompass.track import Track


def heading_of_track(
    track: Track, correction: FieldCorrection | None = None, instance: int = 1, *, two_axis: bool = False
) -> HeadingResult:
    """Compute a recording's tilt-compensated heading; what else tells it may widen its sigma or teach north.

    Args:
        track: the recording.
        correction: applied to the raw field; None leaves the autopilot's own correction in force.
        instance: the compass, counting from 1.
        two_axis: use X and Y only and estimate Z from the world model's field length.

    Raises BadRecording where the compass is missing, the accelerometer is dead, or two_axis is wanted and the
    place is unknown.
    """
    found = heading_by_compass(track, correction, instance, two_axis)
    others = [compass_heading(track, other) for other in other_compasses(track, instance)]
    earth = earth_field_of(track, UNKNOWN_YEAR)
    evidence = compare(track, CompassHeading.of(instance, found), others, earth)
    beyond_rad = isolate_faults(evidence.sources).beyond_rad(0)
    if (north := evidence.north) is None:
        return found.widened(beyond_rad)
    # What true north was learnt from is no witness against that; of the rest it is one as before.
    learnt = {one.by for one in north.learnt}
    rest = [source for source in evidence.sources if source.name not in learnt]
    return found.widened(beyond_rad, isolate_faults(rest).beyond_rad(0)).with_north(north)
