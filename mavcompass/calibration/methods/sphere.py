"""A sphere: the compass turned every way, one gain for all axes."""

from __future__ import annotations

from mavcompass.calibration.methods.ellipsoid import fit_sphere, length_result
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes by the length of the field; no attitude is needed."""
    return length_result(recorded, "sphere", fit_sphere)
