"""From still positions to a judged result: accepted or refused by the heading error that it would leave."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.model import GAIN, HORIZONTAL, VERTICAL
from mavcompass.calibration.observation import Dwell, FourPositionData
from mavcompass.calibration.positions.four_positions import (
    WIDENED_BELOW,
    FourPositionsResult,
    solve_four_positions,
)
from mavcompass.calibration.positions.observability import unobserved
from mavcompass.calibration.result import DEFAULT_LIMITS, CalibrationResult, Limits, Position
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import circle_covered_rad
from mavcompass.units import DEG_PER_RAD

# The Earth's horizontal field is between these nearly everywhere people drive; its total never leaves
# 220 to 670 milligauss.
EARTH_TOTAL_MGAUSS = (220.0, 670.0)
_WIRE_LIMIT_MGAUSS = 32000.0
_WORLD_MISMATCH = 0.3
_TURNED_MOUNT = 0.35

SOURCE_WORDS = {
    "noise": "noise of the compass (dwell longer)",
    "step_angle": "the angles turned (turn faster, or a better gyro)",
    "tilt": "tilt (stand on level, firm ground)",
    "accelerometer": "the accelerometer, which tells the tilt (calibrate it)",
    "world_model": "the Earth's field at this place (move away from steel and buildings)",
    "quantisation": "the whole milligauss of the messages",
    "disturbance": "something magnetic that changed between the positions",
    "prior": "too few positions for all that is unknown (turn through four)",
}


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


def judge(
    data: FourPositionData,
    fit: FourPositionsResult,
    limits: Limits = DEFAULT_LIMITS,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what speaks by itself against a four-position fit, and the warnings if it is accepted."""
    if mounted_wrong := _mounting(fit):
        return tuple(mounted_wrong), ()  # what else seems wrong only follows from that
    reasons: list[str] = []
    warnings: list[str] = []
    reasons += _geometry(data)
    reasons += _field_size(data, fit)
    _judge_disturbance(data, fit, limits, reasons, warnings)
    _judge_current(data, fit, limits, reasons, warnings)
    sigma = fit.heading_sigma_rad * DEG_PER_RAD
    if sigma > limits.heading_deg:
        worst = max(fit.budget_rad, key=lambda name: fit.budget_rad[name])
        reasons.append(
            f"The heading would be uncertain by {sigma:.1f} degrees (limit {limits.heading_deg:g}), "
            f"most of it from {SOURCE_WORDS[worst]}."
        )
    return tuple(reasons), tuple(warnings)


def _geometry(data: FourPositionData) -> list[str]:
    covered = circle_covered_rad(data.turned_rad)
    if covered < math.radians(160.0):
        return [
            f"The vehicle turned too little: the positions cover only {covered * DEG_PER_RAD:.0f} degrees of the"
            " circle. Turn it in four steps of about 90 degrees."
        ]
    return []


def _field_size(data: FourPositionData, fit: FourPositionsResult) -> list[str]:
    means = np.array([d.mean_mgauss for d in data.dwells])
    if np.abs(means).max() > _WIRE_LIMIT_MGAUSS:
        return ["The compass is saturated: its readings stand at the end of their range."]
    gain = 0.5 * (fit.state[GAIN][0] + fit.state[GAIN][1])
    if fit.world_model and abs(gain - 1.0) > _WORLD_MISMATCH:
        return [
            f"The compass's gain is off by {share_words(gain - 1.0)}: the field that turns with the vehicle "
            f"is {100.0 * gain:.0f} % of the Earth's field at this place. Repeat it at least 10 m away: if "
            "the figure stays, it is the scale of sensor or driver (COMPASS_SCALE), otherwise steel nearby."
        ]
    horizontal = float(fit.state[HORIZONTAL]) * gain
    if not fit.world_model and not 15.0 < horizontal < 1.2 * EARTH_TOTAL_MGAUSS[1]:
        return [
            f"The field that turns with the vehicle is {horizontal:.0f} mG; the Earth's is nowhere so "
            f"{'weak' if horizontal <= 15.0 else 'strong'}."
        ]
    return []


def share_words(off: float) -> str:
    """Say how much a gain is off, as people do."""
    return "a third" if 0.28 < abs(off) < 0.38 else f"{100.0 * abs(off):.0f} %"


def _mounting(fit: FourPositionsResult) -> list[str]:
    if fit.mirrored:
        return [
            "The field turns against the gyro: the compass is mounted upside down or its orientation "
            "parameter is wrong (COMPASS_ORIENT, CAL_MAGn_ROT). Correct the orientation and repeat."
        ]
    xz, yz = fit.state[GAIN][4:6]
    if math.hypot(xz, yz) > _TURNED_MOUNT:
        return [
            "The compass's vertical axis sees the horizontal field: it is mounted on its side or its "
            "orientation parameter is wrong. Correct the orientation and repeat."
        ]
    return []


def _name_positions(indices: tuple[int, ...]) -> str:
    numbers = [str(i + 1) for i in sorted(indices)]
    if not 0 < len(numbers) <= 4:
        return "one of the positions"
    if len(numbers) == 1:
        return f"position {numbers[0]}"
    return f"position {', '.join(numbers[:-1])} or {numbers[-1]}"


def _judge_disturbance(
    data: FourPositionData,
    fit: FourPositionsResult,
    limits: Limits,
    reasons: list[str],
    warnings: list[str],
) -> None:
    horizontal = float(fit.state[HORIZONTAL]) * 0.5 * float(fit.state[GAIN][0] + fit.state[GAIN][1])
    for index, dwell in enumerate(data.dwells):
        degrees = math.atan2(dwell.unsteady_mgauss, horizontal) * DEG_PER_RAD
        if degrees > limits.heading_deg:
            reasons.append(
                f"At position {index + 1} the field changed by {dwell.unsteady_mgauss:.0f} mG while "
                "the vehicle stood still: something magnetic moved nearby, or a motor ran."
            )
    apart = fit.disturbance_mgauss
    degrees = math.atan2(apart, horizontal) * DEG_PER_RAD
    named = _name_positions(fit.suspects)
    if fit.consistency < WIDENED_BELOW and fit.heading_sigma_rad * DEG_PER_RAD > limits.heading_deg:
        reasons.append(
            f"The positions do not fit one rigid compass: they disagree by {fit.residual_rms_mgauss:.0f} mG. "
            "Something magnetic moved nearby, the vehicle slipped, or a motor ran. Repeat."
        )
    elif float(fit.disturbed_probability.sum()) > 0.5:
        sentence = (
            f"The field at {named} is off by about {apart:.0f} mG ({degrees:.1f} degrees): something "
            "magnetic moved nearby, or the vehicle slipped"
        )
        if fit.heading_sigma_rad * DEG_PER_RAD > limits.heading_deg:
            reasons.append(f"{sentence}. Repeat it there.")
        elif len(fit.suspects) == 1:
            warnings.append(f"{sentence}; the others agree and were believed.")
        else:
            warnings.append(f"{sentence}; which one cannot be told, and the uncertainty holds each.")
    elif fit.consistency < WIDENED_BELOW:
        warnings.append("The positions fit worse than their noise explains; the uncertainty is widened.")


def current_range_a(dwells: tuple[Dwell, ...]) -> float:
    """Return how much the battery current differed between positions, amperes; 0 where unknown."""
    current = np.array([d.current_a for d in dwells])
    return float(np.ptp(current)) if np.isfinite(current).all() else 0.0


def _judge_current(
    data: FourPositionData,
    fit: FourPositionsResult,
    limits: Limits,
    reasons: list[str],
    warnings: list[str],
) -> None:
    swing = current_range_a(data.dwells)
    if swing < 1.0:
        return
    share = fit.budget_rad["disturbance"] * DEG_PER_RAD
    sentence = f"The battery current differed by {swing:.1f} A between the positions"
    if share > 0.5 * limits.heading_deg:
        reasons.append(
            f"{sentence}, which may bend the heading by {share:.1f} degrees. Let the motors run alike "
            "at each position, or switch them off."
        )
    elif share > 0.1 * limits.heading_deg:
        warnings.append(f"{sentence}; up to {share:.1f} degrees of the uncertainty come from that.")
