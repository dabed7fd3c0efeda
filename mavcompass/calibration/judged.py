"""From still positions at hand to a judged result: what every four-position run ends with."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.model import GAIN, HORIZONTAL, VERTICAL
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import FourPositionsResult, solve_four_positions, unobserved
from mavcompass.calibration.result import DEFAULT_LIMITS, CalibrationResult, Limits, Position
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.calibration.verdict import judge
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.units import DEG_PER_RAD


@single_thread()
def calibrate_positions(
    data: FourPositionData,
    in_force: FieldCorrection = IDENTITY,
    earth: EarthField | None = None,
    instance: int = 1,
    limits: Limits = DEFAULT_LIMITS,
    prior: IronPrior = DEFAULT_PRIOR,
) -> CalibrationResult:
    """Calibrate from still positions that are already at hand; see `solve_four_positions` and `judge`.

    Raises PoorCalibration for fewer than three positions, too little turning or a dead compass.
    """
    fit = solve_four_positions(data, in_force, earth, prior)
    reasons, warnings = judge(data, fit, limits)
    hidden = unobserved(fit, prior)
    if "offset_z" in hidden:
        sigma = math.sqrt(float(fit.covariance[2, 2]))
        warnings = (*warnings, _about_z(earth is not None, sigma))
    return _result(data, fit, in_force, instance, reasons, warnings, hidden)


def _about_z(world_model: bool, sigma_mgauss: float) -> str:
    if world_model:
        return f"Z offset taken from the magnetic model (\u00b1{sigma_mgauss:.0f} mG)."
    return "Z offset left as it was: turning on the level does not show it, and the place is unknown."


def _result(
    data: FourPositionData,
    fit: FourPositionsResult,
    in_force: FieldCorrection,
    instance: int,
    reasons: tuple[str, ...],
    warnings: tuple[str, ...],
    hidden: tuple[str, ...],
) -> CalibrationResult:
    horizontal = float(fit.state[HORIZONTAL])
    if not fit.world_model:
        # The correction's scale makes the mean horizontal diagonal 1, so its field has this length.
        gain = np.diag(fit.correction.matrix)[:2].mean() * 0.5 * float(fit.state[GAIN][:2].sum())
        horizontal *= float(gain)
    vertical = float(fit.state[VERTICAL])
    return CalibrationResult(
        instance=instance,
        method="four-positions",
        accepted=not reasons,
        reasons=reasons,
        warnings=warnings,
        raw_offset_mgauss=-np.asarray(fit.correction.offsets_mgauss),
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
        vertical_mgauss=vertical,
        positions=tuple(
            Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples, residual)
            for turned, dwell, residual in zip(data.turned_rad, data.dwells, fit.residual_mgauss, strict=True)
        ),
    ).compared()
