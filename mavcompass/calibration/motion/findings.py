"""What a fit of a motion shows to be wrong, in a pilot's words: the cause that the data name, its remedy."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.model import GAIN, GYRO_SCALE, HORIZONTAL, MOTOR, NO_HEADING_RAD
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.honesty import Honesty
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import LEAST_CIRCLE_RAD, Sections, sparse_words
from mavcompass.calibration.positions.verdict import share_words
from mavcompass.frames import FloatArray, circle_covered_rad
from mavcompass.units import DEG_PER_RAD

# A gain this far from 1 is told; a compass that differs from the Earth's field by more is not believed.
_GAIN_TOLD, _GAIN_REFUSED = 0.2, 0.4
# A turn on the level does not show the vertical gain: there it may be steel as well as the sensor.
_GAIN_UNPROVEN, _VERTICAL_GAIN_KNOWN = 0.3, 0.035
# Gains that differ by less are alike: the sensor's sensitivity, not steel, which bends the axes unequally.
_ALIKE = 0.2
_TURNED_MOUNT = 0.35
_SCATTER_TOLD_DEG = 1.0
# A gyro's scale is told where it is off by more than sensors come with, and by as many sigmas.
_GYRO_SCALE_TOLD, _GYRO_SCALE_SIGMAS = 0.03, 3.0
# Motors, or a change of the iron, are named where they are at least this share of the horizontal field.
_NAMED_SHARE = 0.1
_MOTORS_REFUSED_SHARE = 0.6


def findings(motion: Motion, honest: Honesty) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the reasons to refuse the fit of a motion, and what should be known of it otherwise."""
    sections, fit, limit_deg = motion.sections, motion.fit, motion.recorded.limits.heading_deg
    load_source = "none" if motion.motors_told else motion.load_source
    reasons: list[str] = []
    warnings: list[str] = []
    sparse = sparse_words(sections)
    if sparse and honest.error.rms_rad() * DEG_PER_RAD > _SCATTER_TOLD_DEG:
        reasons.append(sparse)
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
    motors = float(np.linalg.norm(fit.state[MOTOR])) * float(np.ptp(sections.load))
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
    swing = float(np.ptp(sections.load))
    per_unit = float(np.linalg.norm(fit.state[MOTOR]))
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
