"""The method that the recording can bear: four positions if there are any, else what the motion carries."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mavcompass.calibration.methods import ellipsoid, four_positions, world_field
from mavcompass.calibration.motion.left_out import WORTH_IT_RAD, calm_since_s, last_stretch, since
from mavcompass.calibration.motion.observed import Motion, motion_or_none, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult, surest
from mavcompass.errors import PoorCalibration
from mavcompass.heading.deviation import heading_change_rad

# Two methods that are both sure must agree within so many of their sigmas.
_AGREE_SIGMAS, _AGREE_DEG = 3.0, 2.0
# Still positions are preferred as long as no other method is surer by this factor.
_SURER = 1.25


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate by still positions where the recording has them, else by its whole motion.

    Iron that changed within the recording is noticed, and the last stretch taken.
    Raises PoorCalibration where no method finds a solution.
    """
    if recorded.windows is not None:
        return four_positions.calibrate(recorded)
    motion, change = motion_or_none(recorded), None
    if motion is not None and not _is_of_one_iron(recorded, motion):
        motion, change = last_stretch(motion)
        if change is not None:
            recorded = since(recorded, float(motion.sections.start_s[0]))
    results, refusals = _tried(recorded, motion)
    if not results:
        raise refusals[0]
    result = _chosen(results, motion)
    said = [f"Method: {result.method}, chosen by what the recording holds."]
    if change is not None:
        said.append(change.words())
    return replace(result, warnings=(*said, *result.warnings))


def _is_of_one_iron(recorded: Recorded, motion: Motion) -> bool:
    """Tell whether the field, seen from all sides, has one length throughout: then its iron never changed.

    The length asks for no attitude; what the motion's fit leaves over is the attitude's then, a hand's jerks.
    """
    try:
        fit = ellipsoid.fit_ellipsoid(recorded.track.raw_field(recorded.instance, motors=False))
    except PoorCalibration:
        return False
    left_mgauss2 = fit.residual_rms_mgauss**2 - motion.sections.noise_mgauss**2
    worth_it = WORTH_IT_RAD * motion.fit.horizontal_mgauss
    return fit.coverage >= ellipsoid.LEAST_COVERAGE and left_mgauss2 < worth_it**2


def _tried(
    recorded: Recorded, motion: Motion | None
) -> tuple[list[CalibrationResult], list[PoorCalibration]]:
    """Try the methods in order of what they know of the vehicle."""
    results: list[CalibrationResult] = []
    refusals: list[PoorCalibration] = []
    attempts: list[Callable[[], CalibrationResult]] = [
        lambda: _still(recorded, motion),
        lambda: world_field.calibrate_motion(motion or observe_motion(recorded)),
        lambda: ellipsoid.calibrate_witnessed(recorded, motion),
    ]
    for attempt in attempts:
        try:
            results.append(attempt())
        except PoorCalibration as refusal:
            refusals.append(refusal)
    return results, refusals


def _still(recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Calibrate by still positions; where they contradict each other, by those since the last disturbance."""
    result = four_positions.calibrate_still(recorded, motion)
    calm_s = None if motion is None else calm_since_s(motion)
    if result.accepted or calm_s is None:
        return result
    try:
        later = four_positions.calibrate_still(since(recorded, calm_s), motion)
    except PoorCalibration:
        return result
    said = f"Before {calm_s:.0f} s something was disturbed: only the positions after it count."
    return replace(later, warnings=(said, *later.warnings)) if later.accepted else result


def _chosen(results: list[CalibrationResult], motion: Motion | None = None) -> CalibrationResult:
    """Choose an accepted result, still positions first; refuse it where another sure method contradicts."""
    accepted = [r for r in results if r.accepted]
    if not accepted:
        return surest(results)
    best = surest(accepted)
    if (
        accepted[0].method == "four-positions"
        and accepted[0].heading_sigma_deg < _SURER * best.heading_sigma_deg
    ):
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
    load = 0.0 if motion is None else motion.sections.load_mean
    field = (one.horizontal_mgauss, one.vertical_mgauss)
    return math.degrees(float(heading_change_rad(other.correction, one.correction, *field, load=load).std()))
