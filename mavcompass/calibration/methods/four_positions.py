"""The four-position calibration at its best: still positions found or chosen, fitted, judged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.findings import judge
from mavcompass.calibration.model import GAIN, HORIZONTAL, VERTICAL
from mavcompass.calibration.motion.honesty import claimed
from mavcompass.calibration.motion.observed import Motion, motion_or_none
from mavcompass.calibration.observation import FourPositionData, assemble, dwell_between, observe, turn_record
from mavcompass.calibration.positions import solve_four_positions, unobserved
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import DEFAULT_LIMITS, CalibrationResult, Limits, Position
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.units import DEG_PER_RAD


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


@single_thread()
def calibrate_positions(
    data: FourPositionData,
    in_force: FieldCorrection = IDENTITY,
    earth: EarthField | None = None,
    instance: int = 1,
    limits: Limits = DEFAULT_LIMITS,
    prior: IronPrior = DEFAULT_PRIOR,
) -> CalibrationResult:
    """Calibrate from still positions at hand; see `solve_four_positions` and `findings.judge`.

    Raises PoorCalibration for fewer than three positions, too little turning or a dead compass.
    """
    fit = solve_four_positions(data, in_force, earth, prior)
    reasons, warnings = judge(data, fit, limits, prior)
    hidden = unobserved(fit.covariance, prior)
    if "offset_z" in hidden and earth is not None:
        warnings = (
            *warnings,
            f"Z offset taken from the magnetic model (\u00b1{math.sqrt(fit.covariance[2, 2]):.0f} mG).",
        )
    elif "offset_z" in hidden:
        left = "Z offset left as it was: turning on the level does not show it, and the place is unknown."
        warnings = (*warnings, left)
    horizontal = float(fit.state[HORIZONTAL])
    if not fit.world_model:
        # The correction's scale makes the mean horizontal diagonal 1, so its field has this length.
        gain = np.diag(fit.correction.matrix)[:2].mean() * 0.5 * float(fit.state[GAIN][:2].sum())
        horizontal *= float(gain)
    return CalibrationResult(
        instance=instance,
        method="four-positions",
        accepted=not reasons,
        reasons=reasons,
        warnings=warnings,
        correction=fit.correction,
        in_force=in_force,
        covariance_names=fit.names,
        covariance=fit.covariance,
        not_observable=hidden,
        residual_rms_mgauss=fit.residual_rms_mgauss,
        heading_sigma_deg=fit.heading_sigma_rad * DEG_PER_RAD,
        heading_budget_deg={name: value * DEG_PER_RAD for name, value in fit.budget_rad.items()},
        heading_error=fit.heading_error,
        horizontal_mgauss=horizontal,
        vertical_mgauss=float(fit.state[VERTICAL]),
        positions=tuple(
            Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples, residual)
            for turned, dwell, residual in zip(data.turned_rad, data.dwells, fit.residual_mgauss, strict=True)
        ),
    ).compared()


def witnessed(result: CalibrationResult, motion: Motion | None) -> CalibrationResult:
    """Claim no less than the heading scatter that the correction leaves in the whole motion.

    Where the gyro did not follow the turns, that is the reason, and not what seems to follow from it.
    """
    if motion is None:
        return result
    if not result.accepted and (sparse := motion.sections.sparse()) is not None:
        return replace(result, reasons=(str(sparse),))
    return claimed(motion, result)


def _observed(recorded: Recorded) -> FourPositionData:
    track, instance = recorded.track, recorded.instance
    if recorded.windows is None:
        return observe(track, instance, fewest=recorded.prior.fewest_positions)
    record = turn_record(track, instance)
    dwells = [dwell_between(track, instance, start, end, record) for start, end in recorded.windows]
    return assemble(track, dwells, instance, record)
