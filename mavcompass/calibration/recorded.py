"""What a calibration method is given: one compass of a recording, and what is known besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mavcompass.calibration.result import DEFAULT_LIMITS, Limits, OwnFinding, TrueHeading
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.track import Track


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Hold one compass of a recording.

    Attributes:
        instance: the compass, from 1.
        earth: the Earth's field there and then; None where it is unknown or not to be used.
        limits: what is accepted. prior: what is known of compasses in general.
        windows: still stretches (start, end) that were chosen; None where they are to be found.
        true_heading: where the vehicle points there, if that is given.
        found: by the autopilot's own calibration of these readings, if there was one.
    """

    track: Track
    instance: int = 1
    earth: EarthField | None = None
    limits: Limits = DEFAULT_LIMITS
    prior: IronPrior = DEFAULT_PRIOR
    windows: Sequence[tuple[float, float]] | None = None
    true_heading: TrueHeading | None = None
    found: OwnFinding | None = None

    @property
    def in_force(self) -> FieldCorrection:
        """Return the correction in force at the end of the recording."""
        return self.track.compasses[self.instance].calibration or IDENTITY
