"""From still positions to a judged result: accepted or refused by the heading error that it would leave."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.model import GAIN, HORIZONTAL, VERTICAL
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions.four_positions import (
    WIDENED_BELOW,
    FourPositionsResult,
    solve_four_positions,
)
from mavcompass.calibration.positions.observability import unobserved
from mavcompass.calibration.result import DEFAULT_LIMITS, UNCERTAIN, CalibrationResult, Limits, Position
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import circle_covered_rad
from mavcompass.units import DEG_PER_RAD

# The Earth's horizontal field is between these nearly everywhere people drive: its total never leaves 220 to
# 670 milligauss.
_WEAKEST_MGAUSS, _STRONGEST_MGAUSS = 15.0, 1.2 * 670.0
_WIRE_LIMIT_MGAUSS = 32000.0
_WORLD_MISMATCH = 0.3
_TURNED_MOUNT = 0.35
# How much of the circle must be seen, by the fewest positions: of a quarter turn two thirds.
_COVERED_RAD = {3: math.radians(160.0), 2: math.radians(60.0)}

SOURCE_WORDS = {
    "noise": "noise of the compass (dwell longer)",
    "step_angle": "the angles turned (turn faster, or a better gyro)",
    "tilt": "tilt (stand on level, firm ground)",
    "accelerometer": "the accelerometer, which tells the tilt (calibrate it)",
    "world_model": "the Earth's field at this place (move away from steel and buildings)",
    "quantisation": "the whole milligauss of the messages",
    "disturbance": "something magnetic that changed between the positions",
    "prior": "too few positions for all that is unknown (turn through four)",
    "given_heading": "the heading that was given",
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
        vertical_mgauss=float(fit.state[VERTICAL]),
        positions=tuple(
            Position(float(turned) * DEG_PER_RAD, dwell.mean_mgauss, dwell.samples, residual)
            for turned, dwell, residual in zip(data.turned_rad, data.dwells, fit.residual_mgauss, strict=True)
        ),
    ).compared()


def judge(
    data: FourPositionData,
    fit: FourPositionsResult,
    limits: Limits = DEFAULT_LIMITS,
    prior: IronPrior = DEFAULT_PRIOR,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what speaks by itself against a four-position fit, and the warnings if it is accepted."""
    if mounted_wrong := _mounting(fit):
        return (mounted_wrong,), ()  # what else seems wrong only follows from that
    said = list(_found(data, fit, limits, _COVERED_RAD[prior.fewest_positions]))
    return tuple(words for refused, words in said if refused), tuple(words for no, words in said if not no)


def _found(
    data: FourPositionData, fit: FourPositionsResult, limits: Limits, least_rad: float
) -> Iterator[tuple[bool, str]]:
    """Yield what is to be said of a fit, and whether it is refused for it."""
    covered = circle_covered_rad(data.turned_rad)
    if data.first_heading is None and covered < least_rad:
        words = (
            f"The vehicle turned too little: the positions cover only {covered * DEG_PER_RAD:.0f} degrees of "
            "the circle. Turn it in four steps of about 90 degrees."
        )
        yield True, words
    if size := _field_size(data, fit):
        yield True, size
    yield from _disturbance(data, fit, limits)
    yield from _current(data, fit, limits)
    sigma = fit.heading_sigma_rad * DEG_PER_RAD
    if sigma > limits.heading_deg:
        worst = max(fit.budget_rad, key=lambda name: fit.budget_rad[name])
        words = (
            f"{UNCERTAIN} by {sigma:.1f} degrees (limit {limits.heading_deg:g}), "
            f"most of it from {SOURCE_WORDS[worst]}."
        )
        yield True, words


def _mounting(fit: FourPositionsResult) -> str:
    if fit.mirrored:
        return (
            "The field turns against the gyro: the compass is mounted upside down or its orientation "
            "parameter is wrong (COMPASS_ORIENT, CAL_MAGn_ROT). Correct the orientation and repeat."
        )
    if math.hypot(*fit.state[GAIN][4:6]) > _TURNED_MOUNT:
        return (
            "The compass's vertical axis sees the horizontal field: it is mounted on its side or its "
            "orientation parameter is wrong. Correct the orientation and repeat."
        )
    return ""


def _field_size(data: FourPositionData, fit: FourPositionsResult) -> str:
    if max(float(np.abs(d.mean_mgauss).max()) for d in data.dwells) > _WIRE_LIMIT_MGAUSS:
        return "The compass is saturated: its readings stand at the end of their range."
    gain = 0.5 * (fit.state[GAIN][0] + fit.state[GAIN][1])
    if fit.world_model and abs(gain - 1.0) > _WORLD_MISMATCH:
        return (
            f"The compass's gain is off by {share_words(gain - 1.0)}: the field that turns with the vehicle "
            f"is {100.0 * gain:.0f} % of the Earth's field at this place. Repeat it at least 10 m away: if "
            "the figure stays, it is the scale of sensor or driver (COMPASS_SCALE), otherwise steel nearby."
        )
    horizontal = float(fit.state[HORIZONTAL]) * gain
    if not fit.world_model and not _WEAKEST_MGAUSS < horizontal < _STRONGEST_MGAUSS:
        return (
            f"The field that turns with the vehicle is {horizontal:.0f} mG; the Earth's is nowhere so "
            f"{'weak' if horizontal <= _WEAKEST_MGAUSS else 'strong'}."
        )
    return ""


def share_words(off: float) -> str:
    """Say how much a gain is off, as people do."""
    return "a third" if 0.28 < abs(off) < 0.38 else f"{100.0 * abs(off):.0f} %"


def _name_positions(indices: tuple[int, ...]) -> str:
    numbers = [str(i + 1) for i in sorted(indices)]
    if not 0 < len(numbers) <= 4:
        return "one of the positions"
    if len(numbers) == 1:
        return f"position {numbers[0]}"
    return f"position {', '.join(numbers[:-1])} or {numbers[-1]}"


def _disturbance(
    data: FourPositionData, fit: FourPositionsResult, limits: Limits
) -> Iterator[tuple[bool, str]]:
    horizontal = float(fit.state[HORIZONTAL]) * 0.5 * float(fit.state[GAIN][0] + fit.state[GAIN][1])
    for index, dwell in enumerate(data.dwells):
        if math.atan2(dwell.unsteady_mgauss, horizontal) * DEG_PER_RAD > limits.heading_deg:
            words = (
                f"At position {index + 1} the field changed by {dwell.unsteady_mgauss:.0f} mG while "
                "the vehicle stood still: something magnetic moved nearby, or a motor ran."
            )
            yield True, words
    apart = fit.disturbance_mgauss
    degrees = math.atan2(apart, horizontal) * DEG_PER_RAD
    refused = fit.heading_sigma_rad * DEG_PER_RAD > limits.heading_deg
    if fit.consistency < WIDENED_BELOW and refused:
        words = (
            f"The positions do not fit one rigid compass: they disagree by {fit.residual_rms_mgauss:.0f} mG. "
            "Something magnetic moved nearby, the vehicle slipped, or a motor ran. Repeat."
        )
        yield True, words
    elif float(fit.disturbed_probability.sum()) > 0.5:
        sentence = (
            f"The field at {_name_positions(fit.suspects)} is off by about {apart:.0f} mG "
            f"({degrees:.1f} degrees): something magnetic moved nearby, or the vehicle slipped"
        )
        if refused:
            yield True, f"{sentence}. Repeat it there."
        elif len(fit.suspects) == 1:
            yield False, f"{sentence}; the others agree and were believed."
        else:
            yield False, f"{sentence}; which one cannot be told, and the uncertainty holds each."
    elif fit.consistency < WIDENED_BELOW:
        yield False, "The positions fit worse than their noise explains; the uncertainty is widened."


def _current(data: FourPositionData, fit: FourPositionsResult, limits: Limits) -> Iterator[tuple[bool, str]]:
    swing = float(np.ptp([d.current_a for d in data.dwells]))
    if not swing >= 1.0:  # or it was not recorded
        return
    share = fit.budget_rad["disturbance"] * DEG_PER_RAD
    sentence = f"The battery current differed by {swing:.1f} A between the positions"
    if share > 0.5 * limits.heading_deg:
        words = (
            f"{sentence}, which may bend the heading by {share:.1f} degrees. Let the motors run alike "
            "at each position, or switch them off."
        )
        yield True, words
    elif share > 0.1 * limits.heading_deg:
        yield False, f"{sentence}; up to {share:.1f} degrees of the uncertainty come from that."
