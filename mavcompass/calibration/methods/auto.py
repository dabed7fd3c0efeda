"""The surest of the methods that the recording can bear: still positions, its motion, the field's length."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mavcompass.calibration.methods import ellipsoid, four_positions, world_field
from mavcompass.calibration.motion.left_out import last_stretch, since
from mavcompass.calibration.motion.observed import Motion, motion_or_none, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, surest
from mavcompass.errors import PoorCalibration
from mavcompass.frames import NO_HEADING_RAD
from mavcompass.heading.deviation import Loads, heading_change_rad

# Two methods that are both sure must agree within so many of their sigmas.
_AGREE_SIGMAS, _AGREE_DEG = 3.0, 2.0
# Sigmas are known to a tenth: of methods as sure as that the first counts, whose positions everybody sees.
_ALIKE = 1.1


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate by the surest method; by still positions where these were chosen, or are as sure.

    Iron that changed within the recording is noticed, and the last stretch taken.
    Raises PoorCalibration where no method finds a solution.
    """
    if recorded.windows is not None:
        return four_positions.calibrate(recorded)
    motion, change = motion_or_none(recorded), None
    # Iron that changed shows by what turns and compass contradict, which a gyro has to follow.
    if motion is not None and motion.sections.sparse(NO_HEADING_RAD) is None:
        motion, change = last_stretch(motion)
        if change is not None:
            recorded = since(recorded, float(motion.sections.start_s[0]))
    results: list[CalibrationResult] = []
    refusals: list[PoorCalibration] = []
    attempts: list[Callable[[], CalibrationResult]] = [  # in order of what they know of the vehicle
        lambda: four_positions.calibrate_still(recorded, motion),
        lambda: world_field.calibrate_motion(motion or observe_motion(recorded)),
        lambda: ellipsoid.calibrate_witnessed(recorded, motion),
    ]
    for attempt in attempts:
        try:
            results.append(attempt())
        except PoorCalibration as refusal:
            refusals.append(refusal)
    if not results:
        raise refusals[0]
    result = _chosen(results, motion)
    said = [f"Method: {result.method}, chosen by what the recording holds."]
    if change is not None:
        said.append(change.words())
    return replace(result, warnings=(*said, *result.warnings))


def _chosen(results: list[CalibrationResult], motion: Motion | None = None) -> CalibrationResult:
    """Choose the surest of the accepted results; refuse it where another sure method contradicts."""
    accepted = [r for r in results if r.accepted]
    if not accepted:
        return surest(results)
    best = surest(accepted)
    if accepted[0].heading_sigma_deg < _ALIKE * best.heading_sigma_deg:
        best = accepted[0]
    for other in accepted:
        apart = _apart_deg(best, other, motion)
        allowed = max(_AGREE_SIGMAS * math.hypot(best.heading_sigma_deg, other.heading_sigma_deg), _AGREE_DEG)
        if apart > allowed:
            reason = (
                f"The methods {best.method} and {other.method} are both sure and {apart:.1f} degrees "
                "apart. Something magnetic changed, or the manoeuvres were not followed. Record again."
            )
            return replace(best, accepted=False, reasons=(*best.reasons, reason))
    return best


def _apart_deg(one: CalibrationResult, other: CalibrationResult, motion: Motion | None) -> float:
    """Return by how much two results' headings differ at the mean load, rms without their mean."""
    loads: Loads = {} if motion is None else {motion.goes_with: motion.sections.loads_mean}
    field = (one.horizontal_mgauss, one.vertical_mgauss)
    apart_rad = heading_change_rad(other.correction, one.correction, *field, loads=loads)
    return math.degrees(float(apart_rad.std()))
