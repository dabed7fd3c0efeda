"""The four-position calibration at its best: still positions found or chosen, fitted, judged."""

from __future__ import annotations

from dataclasses import replace

from mavcompass.calibration.motion.observed import Motion, motion_or_none
from mavcompass.calibration.motion.sections import sparse_words
from mavcompass.calibration.observation import FourPositionData, assemble, dwell_between, observe, turn_record
from mavcompass.calibration.positions.verdict import calibrate_positions
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Calibrate from the recording's still positions and the gyro's turns between them."""
    return calibrate_still(recorded, None if recorded.windows is not None else motion_or_none(recorded))


def calibrate_still(recorded: Recorded, motion: Motion | None) -> CalibrationResult:
    """Calibrate by the positions, held against the motion between them.

    Raises PoorCalibration where the vehicle stood still at fewer than three positions.
    """
    result = calibrate_positions(
        _observed(recorded),
        recorded.in_force,
        recorded.earth,
        recorded.instance,
        recorded.limits,
        recorded.prior,
    )
    return witnessed(result, motion)


def witnessed(result: CalibrationResult, motion: Motion | None) -> CalibrationResult:
    """Claim no less than the heading scatter that the correction leaves in the whole motion.

    Where the gyro did not follow the turns, that is the reason, and not what seems to follow from it.
    """
    if motion is None:
        return result
    if not result.accepted and (sparse := sparse_words(motion.sections)):
        return replace(result, reasons=(sparse,))
    return motion.claimed(result)


def _observed(recorded: Recorded) -> FourPositionData:
    track, instance = recorded.track, recorded.instance
    if recorded.windows is None:
        return observe(track, instance, fewest=recorded.prior.fewest_positions)
    record = turn_record(track, instance)
    dwells = [dwell_between(track, instance, start, end, record) for start, end in recorded.windows]
    return assemble(track, dwells, instance, record)
