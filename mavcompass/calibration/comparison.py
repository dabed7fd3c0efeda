"""What methods other than the best share in becoming a result: old against new, the limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.verdict import Limits
from mavcompass.units import DEG_PER_RAD

UNCERTAIN = "The heading would be uncertain"


def compared(result: CalibrationResult) -> CalibrationResult:
    """Add what changes in the heading from the correction in force."""
    change = result.change_rad()
    return replace(
        result,
        heading_change_deg=math.sqrt(float((change**2).mean())) * DEG_PER_RAD,
        heading_change_max_deg=float(np.abs(change).max()) * DEG_PER_RAD,
    )


def within(result: CalibrationResult, limits: Limits, why: str = "") -> CalibrationResult:
    """Accept a result without reasons against it and a sigma within the limit; `why` is what widened it."""
    reasons = list(result.reasons)
    if not result.heading_sigma_deg <= limits.heading_deg:
        uncertain = f"{UNCERTAIN} by {result.heading_sigma_deg:.1f} degrees (limit {limits.heading_deg:g})."
        reasons += [] if any(UNCERTAIN in reason for reason in reasons) else [why or uncertain]
    return replace(result, reasons=tuple(reasons), accepted=not reasons)


def at_least(result: CalibrationResult, scatter_rad: float, limits: Limits) -> CalibrationResult:
    """Claim no less than a heading scatter that was seen to be left, and judge again by it."""
    scatter = scatter_rad * DEG_PER_RAD
    if scatter <= result.heading_sigma_deg:
        return result
    left = (
        f"The corrected heading would still scatter by {scatter:.1f} degrees about the gyro's "
        f"(limit {limits.heading_deg:g}): motors, something magnetic, or manoeuvres not followed."
    )
    return within(result.widened(scatter, "disturbance"), limits, left)
