"""The four-position calibration at its best: still positions found or chosen, fitted, judged."""

from __future__ import annotations

from dataclasses import replace

from mavcompass.calibration.motion.findings import sparse_words
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.observation import FourPositionData, assemble, dwell_between, observe, turn_record
from mavcompass.calibration.positions.verdict import calibrate_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.errors import PoorCalibration


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate from the recording's still positions and the gyro's turns between them."""
    if recorded.windows is not None:
        return _solved(recorded, _observed(recorded))
    try:
        motion = observe_motion(recorded)
    except PoorCalibration:
        motion = None
    return _witnessed(_solved(recorded, _observed(recorded)), recorded, motion)


def calibrate_still(recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Calibrate from positions at which the vehicle really stood still.

    Raises PoorCalibration where it did so at fewer than three.
    """
    data = _observed(recorded)
    if len(data.dwells) < 3:
        raise PoorCalibration(
            f"The vehicle stood still at {len(data.dwells)} places only.",
            "Turn it in four steps of about 90 degrees and stop after each.",
        )
    return _witnessed(_solved(recorded, data), recorded, motion)


def _witnessed(result: CalibrationResult, recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Claim no less than the heading scatter that the correction leaves in the whole motion.

    Where the gyro did not follow the turns, that is the reason, and not what seems to follow from it.
    """
    if motion is None:
        return result
    if not result.accepted and (sparse := sparse_words(motion.sections)):
        return replace(result, reasons=(sparse,))
    return result.at_least(motion.scatter_left_rad(result.correction), recorded.limits)


def _solved(recorded: Recorded, data: FourPositionData) -> CalibrationResult:
    return calibrate_positions(
        data,
        recorded.in_force,
        recorded.earth,
        recorded.instance,
        recorded.limits,
        recorded.prior,
    )


def _observed(recorded: Recorded) -> FourPositionData:
    track, instance = recorded.track, recorded.instance
    if recorded.windows is None:
        return observe(track, instance)
    record = turn_record(track, instance)
    dwells = [dwell_between(track, instance, start, end, record) for start, end in recorded.windows]
    return assemble(track, dwells, instance, record)
