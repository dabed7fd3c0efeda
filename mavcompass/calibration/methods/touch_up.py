"""Touch-up: a battery or a payload has moved the iron; the scales of the calibration in force are kept.

By a quarter turn: two positions tell offset, first heading and the strength of the field, as (M1) has them,
where the gains T are known before. A whole calibration measures these, too.
"""

from __future__ import annotations

from dataclasses import replace

from mavcompass.calibration.methods import four_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.errors import PoorCalibration


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate the offsets by two positions or more.

    Raises PoorCalibration where the compass has never been calibrated, or the vehicle turned too little.
    """
    if not any(recorded.in_force.offsets_mgauss):
        raise PoorCalibration(
            f"Compass {recorded.instance} has never been calibrated: a touch-up keeps what a calibration has"
            " measured, and there is none.",
            "Turn it through four positions.",
        )
    known = replace(recorded, prior=recorded.prior.of(recorded.in_force))
    return replace(four_positions.calibrate(known), method="touch-up")
