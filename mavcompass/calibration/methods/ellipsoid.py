"""An ellipsoid: the compass turned every way, gains and oblique axes."""

from __future__ import annotations

from mavcompass.calibration.fits.length import fit_ellipsoid
from mavcompass.calibration.methods._length import length_result
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate all axes by the length of the field; no attitude is needed."""
    total = recorded.earth.total_mgauss if recorded.earth is not None else None
    return length_result(recorded, "ellipsoid", lambda raw: fit_ellipsoid(raw, total))
