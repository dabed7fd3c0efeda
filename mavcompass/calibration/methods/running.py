"""A running calibration: what the latest minutes of work show, as a service learns while the vehicle is used.

Nothing is kept but the recording of these minutes, so that memory is constant. Their motion is fitted and
judged as `world_field` does it. Nobody drives a pattern here, so more is asked before the result is believed:
each half of the minutes must go round by itself, so that it can be held against the other.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.methods.world_field import calibrate_motion
from mavcompass.calibration.motion.left_out import last_stretch, since
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult

# More than this is not kept.
WINDOW_S = 600.0
_SECTORS = 12


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate by the last minutes of a recording.

    Raises PoorCalibration where it has no gyro, or hardly turned.
    """
    end_s = float(recorded.track.compasses[recorded.instance].time_s[-1])
    motion = observe_motion(since(recorded, end_s - WINDOW_S))
    later, changed = last_stretch(motion)
    if changed is not None and changed.is_iron:
        motion = later
    else:
        changed = None
    result, not_seen_deg = calibrate_motion(motion), _not_seen_deg(motion)
    reasons, said = result.reasons, [] if changed is None else [changed.words()]
    if motion.halves() is None:
        unproven = (
            "The vehicle did not go round often enough to hold one half of its way against the other. "
            "Drive or fly on, through all headings."
        )
        reasons = (*reasons, unproven)
    if not_seen_deg:
        parts = ", ".join(f"{deg} to {deg + 360 // _SECTORS}" for deg in not_seen_deg)
        said.append(f"Not seen yet: headings {parts} degrees.")
    return replace(
        result,
        method="running",
        accepted=not reasons,
        reasons=reasons,
        warnings=(*said, *result.warnings),
        not_seen_deg=not_seen_deg,
        changed=changed,
    )


def _not_seen_deg(motion: Motion) -> tuple[int, ...]:
    part = np.mod(motion.fit.headings_rad[motion.fit.sound > 0.5], 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS
    seen = np.bincount(np.minimum(part.astype(np.intp), _SECTORS - 1), minlength=_SECTORS)
    return tuple(int(360 / _SECTORS * k) for k in np.flatnonzero(seen == 0))
