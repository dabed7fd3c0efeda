"""A running calibration: what the latest minutes of work show, as a service learns while the vehicle is used.

Nothing is kept but the recording of these minutes, so that memory is constant. Their motion is fitted and
judged as `world_field` does it. Nobody drives a pattern here, so more is asked before the result is believed:
each half of the minutes must go round by itself, so that it can be held against the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.methods.world_field import calibrate_motion
from mavcompass.calibration.motion.left_out import Change, last_stretch, since
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult

# More than this is not kept.
WINDOW_S = 600.0
_SECTORS = 12
_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """Hold what was learnt of one compass.

    Attributes:
        result: the calibration, not accepted where it is not to be believed yet.
        not_seen_deg: the twelfths of the circle that it did not point to, by their first magnetic heading.
        change: when the iron last changed, None where it did not; only what came after counts.
    """

    result: CalibrationResult
    not_seen_deg: tuple[int, ...]
    change: Change | None

    @property
    def gain_deg(self) -> float:
        """Return by how much at least it lowers the heading error in force, at three sigmas; 0 if unsure."""
        if not self.result.accepted:
            return 0.0
        return max(self.result.heading_change_deg - _SIGMAS * self.result.heading_sigma_deg, 0.0)


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate by the last minutes of a recording. Raises what `learn` raises."""
    end_s = float(recorded.track.compasses[recorded.instance].time_s[-1])
    learnt = learn(since(recorded, end_s - WINDOW_S))
    said = [] if learnt.change is None else [learnt.change.words()]
    if learnt.not_seen_deg:
        parts = ", ".join(f"{deg} to {deg + 360 // _SECTORS}" for deg in learnt.not_seen_deg)
        said.append(f"Not seen yet: headings {parts} degrees.")
    return replace(learnt.result, warnings=(*said, *learnt.result.warnings))


def learn(recorded: Recorded) -> Learnt:
    """Tell what a recording of some minutes shows of a compass.

    Raises PoorCalibration where the recording has no gyro, or hardly turned.
    """
    motion = observe_motion(recorded)
    later, change = last_stretch(motion)
    if change is not None and change.is_iron:
        motion = later
    else:
        change = None
    result = calibrate_motion(motion)
    reasons = result.reasons
    if motion.halves() is None:
        unproven = (
            "The vehicle did not go round often enough to hold one half of its way against the other. "
            "Drive or fly on, through all headings."
        )
        reasons = (*reasons, unproven)
    result = replace(result, method="running", reasons=reasons, accepted=not reasons)
    return Learnt(result, _not_seen_deg(motion), change)


def _not_seen_deg(motion: Motion) -> tuple[int, ...]:
    part = np.mod(motion.fit.headings_rad[motion.fit.sound > 0.5], 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS
    seen = np.bincount(np.minimum(part.astype(np.intp), _SECTORS - 1), minlength=_SECTORS)
    return tuple(int(360 / _SECTORS * k) for k in np.flatnonzero(seen == 0))
