"""An ellipsoid: the compass turned every way, gains and oblique axes."""

from __future__ import annotations

from mavcompass.calibration.methods._length import fit_ellipsoid, length_result
from mavcompass.calibration.motion.observed import Motion, motion_or_none
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes by the length of the field; no attitude is needed."""
    return calibrate_witnessed(recorded, motion_or_none(recorded))


def calibrate_witnessed(recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Calibrate, and claim no less than the heading scatter that is left in the motion."""
    total = recorded.earth.total_mgauss if recorded.earth is not None else None
    result = length_result(recorded, "ellipsoid", lambda raw: fit_ellipsoid(raw, total))
    return result if motion is None else motion.claimed(result)
