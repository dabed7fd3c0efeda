"""What a fit of positions or of a motion shows to be wrong, in a pilot's words: the cause, its remedy."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mavcompass.calibration.model import GAIN, GYRO_SCALE, HORIZONTAL
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.honesty import Honesty
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import LEAST_CIRCLE_RAD, Sections
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions import WIDENED_BELOW, FourPositionsResult
from mavcompass.calibration.result import DEFAULT_LIMITS, UNCERTAIN, Limits
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.frames import NO_HEADING_RAD, FloatArray, circle_covered_rad
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
# A gain this far from 1 is told; a compass that differs from the Earth's field by more is not believed.
_GAIN_TOLD, _GAIN_REFUSED = 0.2, 0.4
# A turn on the level does not show the vertical gain: there it may be steel as well as the sensor.
_GAIN_UNPROVEN, _VERTICAL_GAIN_KNOWN = 0.3, 0.035
# Gains that differ by less are alike: the sensor's sensitivity, not steel, which bends the axes unequally.
_ALIKE = 0.2
_SCATTER_TOLD_DEG = 1.0
# A gyro's scale is told where it is off by more than sensors come with, and by as many sigmas.
_GYRO_SCALE_TOLD, _GYRO_SCALE_SIGMAS = 0.03, 3.0
# Motors, or a change of the iron, are named where they are at least this share of the horizontal field.
_NAMED_SHARE = 0.1
_MOTORS_REFUSED_SHARE = 0.6


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


# --- of a motion ------------------------------------------------------------------------------------


def findings(motion: Motion, honest: Honesty) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the reasons to refuse the fit of a motion, and what should be known of it otherwise."""
    sections, fit, limit_deg = motion.sections, motion.fit, motion.recorded.limits.heading_deg
    load_source = "none" if motion.motors_told else motion.load_source
    reasons: list[str] = []
    warnings: list[str] = []
    sparse = sections.sparse()
    if sparse is not None and honest.error.rms_rad() * DEG_PER_RAD > _SCATTER_TOLD_DEG:
        reasons.append(str(sparse))
    seen = circle_covered_rad(fit.headings_rad)
    if seen < LEAST_CIRCLE_RAD:
        reasons.append(
            f"The vehicle pointed to only {seen * DEG_PER_RAD:.0f} degrees of the circle. "
            "Turn it all the way round."
        )
    gains, crosses = fit.state[GAIN][:3], fit.state[GAIN][3:]
    sigma = np.sqrt(np.diag(fit.covariance)[GAIN])
    crossed = float((np.abs(crosses) - sigma[3:]).max()) > _TURNED_MOUNT
    if crossed or float((gains + sigma[:3])[:2].min()) < 0.0:
        reasons.append(
            "The field does not turn as the vehicle does: the compass is mounted turned or upside down, or "
            "its orientation parameter is wrong (COMPASS_ORIENT, CAL_MAGn_ROT), or the gyro's axes are not "
            "the vehicle's. Correct the orientation and repeat."
        )
    elif motion.recorded.earth is not None and (about_gain := gain_words(gains)):
        far = float(np.abs(gains - 1.0).max())
        believed = far < _GAIN_REFUSED and (far < _GAIN_UNPROVEN or _vertical_gain_known(fit))
        (warnings if believed else reasons).append(about_gain)
    scatter = min(honest.scatter_rad, NO_HEADING_RAD) * DEG_PER_RAD
    if scatter > _SCATTER_TOLD_DEG:
        left = f"The corrected heading still scatters by {scatter:.1f} degrees"
        words = left + _cause(sections, fit, load_source)
        (reasons if scatter > limit_deg else warnings).append(words)
    horizontal = abs(float(fit.state[HORIZONTAL]))
    motors = float(np.linalg.norm(np.ptp(sections.loads @ fit.motors_mgauss, axis=0)))
    if load_source != "none" and motors > _MOTORS_REFUSED_SHARE * horizontal:
        reasons.append(
            f"The motors' field of {motors:.0f} mG is {100.0 * motors / horizontal:.0f} % of the Earth's "
            "horizontal field: no compensation is that exact. Move the compass away from the power leads."
        )
    warnings += [words for words in (_gyro_words(fit), _kept_out_words(sections, fit)) if words]
    return tuple(reasons), tuple(warnings)


def gain_words(gains: FloatArray) -> str:
    """Say how far the gains are from what the Earth's field asks for, or "" where they are near."""
    mean = float(gains.mean())
    off = abs(mean - 1.0)
    if off < _GAIN_TOLD:
        return ""
    share = share_words(off)
    reads = f"it reads {100.0 * mean:.0f} % of the Earth's field at this place"
    if float(np.ptp(gains)) > _ALIKE:
        return (
            f"The compass's gain is off by {share}, and not alike on its axes: {reads}. Steel near the "
            "vehicle or under the ground, or a faulty axis: move at least 10 m away and repeat."
        )
    return (
        f"The compass's gain is off by {share}: {reads}, alike on every axis, so it is the sensor's or its "
        "driver's scale (COMPASS_SCALE), not steel. The correction takes it out."
    )


def _vertical_gain_known(fit: MotionFit) -> bool:
    """Say whether the motion, not the prior, tells the vertical gain beside the horizontal ones."""
    difference = np.array([-0.5, -0.5, 1.0])
    variance = float(difference @ fit.covariance[GAIN, GAIN][:3, :3] @ difference)
    return math.sqrt(variance) < _VERTICAL_GAIN_KNOWN


def _cause(sections: Sections, fit: MotionFit, load_source: str) -> str:
    """Name what the scatter comes from, as far as the data show it, and what to do."""
    named = _NAMED_SHARE * abs(float(fit.state[HORIZONTAL]))
    swing = float(np.ptp(sections.loads[:, 0]))
    per_unit = float(np.linalg.norm(fit.motors_mgauss[0]))
    if load_source != "none" and per_unit * swing > named:
        load = (
            f"battery current swung by {swing:.0f} A and moves the field by {per_unit:.1f} mG/A"
            if load_source == "current"
            else f"throttle moves the field by {per_unit * swing:.0f} mG"
        )
        return f": the {load}. Move the compass away from the power leads, or turn with the motors alike."
    first, second = (half.mean(axis=0) for half in np.array_split(fit.residual_mgauss, 2))
    apart = float(np.linalg.norm(second - first))
    if apart > named:
        return (
            f": between the first and the second half of the recording the iron changed by {apart:.0f} mG. "
            "Record again after whatever was moved."
        )
    return (
        ": something magnetic near the vehicle, motors, or hard manoeuvres that its attitude did not follow."
    )


def _gyro_words(fit: MotionFit) -> str:
    off, sigma = float(fit.state[GYRO_SCALE]), math.sqrt(float(fit.covariance[GYRO_SCALE, GYRO_SCALE]))
    if abs(off) < max(_GYRO_SCALE_TOLD, _GYRO_SCALE_SIGMAS * sigma):
        return ""
    return (
        f"The gyro reads {100.0 * abs(off):.0f} % {'more' if off > 0.0 else 'less'} than the vehicle turned: "
        "after a full circle the compass is where it was and the gyro is not. The calibration takes that "
        "out; a heading held against this gyro seems to scatter."
    )


def _kept_out_words(sections: Sections, fit: MotionFit) -> str:
    disturbed = float((1.0 - fit.sound).sum())
    if disturbed < max(0.5, 0.02 * len(sections)):
        return ""
    worst = int(np.argmin(fit.sound))
    return (
        f"{disturbed:.0f} of {len(sections)} stretches were kept out: something magnetic passed by (the most "
        f"at {sections.middle_s[worst]:.0f} s, {np.linalg.norm(fit.residual_mgauss[worst]):.0f} mG)."
    )
