"""The other methods on a recording: each brought into the same result, each judged in degrees."""

from __future__ import annotations

from dataclasses import replace

from mavcompass.calibration.methods.comparison import UNCERTAIN
from mavcompass.calibration.methods.field import world_field_method
from mavcompass.calibration.methods.length import length_method
from mavcompass.calibration.methods.level import level_method
from mavcompass.calibration.positions import IronPrior
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.verdict import Limits
from mavcompass.earth_field import EarthField
from mavcompass.track import Track


def calibrate_otherwise(
    track: Track,
    method: str,
    instance: int,
    limits: Limits,
    earth: EarthField | None,
    prior: IronPrior,
) -> CalibrationResult:
    """Calibrate one compass by a method other than the best; see `calibrate.calibrate_track`."""
    if method in ("min-max", "sensitivity-bias", "four-positions-textbook"):
        result = level_method(track, method, instance, earth, prior)
    elif method in ("sphere", "ellipsoid"):
        result = length_method(track, method, instance, earth)
    else:
        result = world_field_method(track, instance, earth, prior)
    return _judged(result, limits)


def _judged(result: CalibrationResult, limits: Limits) -> CalibrationResult:
    """Refuse by the predicted heading error, beside the method's own reasons."""
    reasons = list(result.reasons)
    if not result.heading_sigma_deg <= limits.heading_deg:
        reasons.append(
            f"{UNCERTAIN} by {result.heading_sigma_deg:.1f} degrees (limit {limits.heading_deg:g})."
        )
    return replace(result, reasons=tuple(reasons), accepted=not reasons)
