"""What a fit of a motion may claim: its covariance, widened by what left-out blocks and the scatter show.

Whole blocks are left out of the fit, one after the other: tenths of the time, then eighths of the circle.
Where the model is right the heading moves by as much as the block's own information lets expect; the
ratio of the two, over all blocks and headings, has the mean 1. A ratio beyond chance multiplies the
covariance. The heading scatter that is left, between sections and second by second (the compass against the
gyro), is the least that is claimed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import levels
from mavcompass.calibration.cross_terms import weigh_cross_terms
from mavcompass.calibration.model import HORIZONTAL, LAG, VERTICAL, HeadingError, heading_gradient
from mavcompass.calibration.motion.fit import MotionFit, leaning_error, motors_variance
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import Sections, unsettled
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.compute import tilt_compensated_heading

_TIME_BLOCKS, _SECTORS = 10, 8
# A ratio up to this is chance.
_BY_CHANCE = 3.0
# While turning or tilting the lag of the field and of the tilt would be seen, not the compass's error.
_SLOW_RADPS = math.radians(5.0)
_FEWEST_S = 5
# Where the tilt is known no better than this the compass is not seen either: that must not excuse the rest.
_TILT_KNOWN_RAD = math.radians(1.5)
# Leaning more than this, a nose has hardly a heading.
_LEAST_UPRIGHT = math.cos(math.radians(45.0))
# What counts as chance: so many standard deviations of the noise's own variance.
_CHANCE = 4.0
_CIRCLE = np.arange(36) * (2.0 * math.pi / 36)


@dataclass(frozen=True, slots=True, eq=False)
class Honesty:
    """Hold what a fit may claim.

    Attributes:
        state: the fit's, its cross terms as far as they are believed.
        error: the heading's, all told. noise_rad: its rms by noise and prior alone.
        accelerometer_rad: the part of the accelerometer's own error, rms, which no further motion lowers.
        scatter_rad: what is left between sections, seen as a heading; 0 where chance explains it.
    """

    state: FloatArray
    error: HeadingError
    noise_rad: float
    accelerometer_rad: float
    scatter_rad: float

    def at_least(self, scatter_rad: float) -> Honesty:
        """Claim no less than a scatter that was seen."""
        if scatter_rad <= self.scatter_rad:
            return self
        factor = max(scatter_rad / self.error.rms_rad(), 1.0)
        wider = HeadingError(self.error.state, self.error.covariance * factor**2)
        return replace(self, error=wider, scatter_rad=scatter_rad)


def weigh_honestly(sections: Sections, fit: MotionFit, prior: IronPrior = DEFAULT_PRIOR) -> Honesty:
    """Judge a fit by blocks left out and by the scatter that it leaves."""
    state, covariance, shared = weigh_cross_terms(
        fit.state, fit.covariance, prior, leaning_error(sections, fit)
    )
    leaning = (shared @ shared.T)[:9, :9]
    covariance = covariance[:9, :9] - leaning
    ratio = max(_left_out(fit, _by_time(sections)), _left_out(fit, _by_heading(fit)))
    claimed = HeadingError(state[:11], covariance)
    noise = claimed.rms_rad()
    widened = noise * math.sqrt(ratio if ratio > _BY_CHANCE else 1.0)
    scatter = _scatter(sections, fit)
    final = max(widened, scatter)
    error = HeadingError(state[:11], covariance * (final / noise) ** 2 + leaning)
    return Honesty(state, error, noise, HeadingError(state[:11], leaning).rms_rad(), scatter)


def _by_time(sections: Sections) -> NDArray[np.intp]:
    span = max(float(sections.end_s[-1] - sections.start_s[0]), 1e-9)
    part = (sections.middle_s - sections.start_s[0]) / span
    return np.minimum((part * _TIME_BLOCKS).astype(np.intp), _TIME_BLOCKS - 1)


def _by_heading(fit: MotionFit) -> NDArray[np.intp]:
    return np.floor(np.mod(fit.headings_rad, 2.0 * math.pi) / (2.0 * math.pi) * _SECTORS).astype(np.intp)


def _left_out(fit: MotionFit, block: NDArray[np.intp]) -> float:
    """Return by how much more the heading moves than expected where blocks are left out, squared."""
    gradient = np.zeros((_CIRCLE.size, fit.state.size))
    gradient[:, :9] = heading_gradient(fit.state, _CIRCLE)
    rows = np.repeat(block, 3)
    field_rows = fit.jacobian[: rows.size]
    before = np.einsum("ni,ij,nj->n", gradient, fit.covariance, gradient)
    information = fit.information
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-24))
    moved = expected = 0.0
    for one in np.unique(block):
        inside = field_rows[rows == one]
        rest = (information - inside.T @ inside) * np.outer(scale, scale)
        rest[np.diag_indices_from(rest)] += 1e-9
        pull = inside.T @ fit.whitened[: rows.size][rows == one]
        solved = np.linalg.solve(rest, (np.column_stack([pull, gradient.T])) * scale[:, np.newaxis])
        answers = gradient @ (solved * scale[:, np.newaxis])
        without = np.einsum("nn->n", answers[:, 1:])
        if not float(without.max()) < math.radians(30.0) ** 2:
            continue  # Without this block nothing is known: it cannot be judged by the rest.
        moved += float((answers[:, 0] ** 2).sum())
        expected += float(np.maximum(without - before, 0.0).sum())
    return moved / expected if expected > 0.0 else 1.0


def _scatter(sections: Sections, fit: MotionFit) -> float:
    """Return the heading scatter between sections that noise does not explain, radians."""
    if fit.error.mgauss <= 0.0:
        return 0.0
    psi = fit.headings_rad
    east = np.stack([np.sin(psi), np.cos(psi), np.zeros(psi.size)], axis=1)
    across = np.einsum("kij,kj->ki", sections.mapping, east) @ np.linalg.inv(fit.gain) / fit.state[HORIZONTAL]
    angle = (across * fit.residual_mgauss).sum(axis=1)
    spread = np.einsum("ki,kij,kj->k", across, fit.variance_mgauss2, across)
    model = fit.error.mgauss**2 * (across**2).sum(axis=1)
    share = fit.sound / sections.repeats
    share = share / share.sum()
    seen = float(share @ angle**2) - float(share @ (spread - model))
    return math.sqrt(max(seen, float(share @ model)))


def claimed(motion: Motion, result: CalibrationResult) -> CalibrationResult:
    """Claim no less for a result than the heading scatter that its correction leaves in the motion."""
    return result.at_least(scatter_left_rad(motion, result.correction), motion.recorded.limits)


def scatter_left_rad(motion: Motion, correction: FieldCorrection) -> float:
    """Return the heading scatter that a correction leaves, radians; 0 where nothing can tell.

    That is where the gyro was recorded too seldom, and where roll and pitch are hardly known.
    """
    track, instance, source = motion.recorded.track, motion.recorded.instance, correction.motor_source
    if motion.sections.sparse() is not None:
        return 0.0
    time = track.compasses[instance].time_s
    load = track.load_of(correction, time)
    field = correction.apply(track.raw_field(instance, motors=source != "none"), load)
    down = (levels(track) if motion.reference is None else motion.reference.levels(track)).at(time)
    scatter, motors = gyro_scatter_rad(motion, field, down), 0.0
    if motion.load_source != "none":
        left = motion.fit.motors_mgauss
        if correction.goes_with == motion.goes_with:
            left = left + np.linalg.solve(correction.matrix, correction.motors.T).T
        motors = motors_left_rad(motion.sections, motion.fit, left)
    return math.hypot(scatter, motors)


def gyro_scatter_rad(motion: Motion, field_mgauss: FloatArray, down: FloatArray) -> float:
    """Return the rms scatter of a corrected compass's heading about the gyro's, beyond noise; radians.

    Args:
        motion: its fit tells the lag, the gyro's drift, and which sections are disturbed: these do not count.
        field_mgauss: the corrected field, (N, 3). down: which way is down in the body, (N, 3).
    """
    track, instance, record = motion.recorded.track, motion.recorded.instance, motion.record
    sections, fit = motion.sections, motion.fit
    time = track.compasses[instance].time_s
    usable = np.isfinite(field_mgauss).all(axis=1)
    usable &= (time >= sections.start_s[0]) & (time <= sections.end_s[-1])
    usable &= ~unsettled(track, instance)
    section = np.clip(np.searchsorted(sections.start_s, time, side="right") - 1, 0, len(sections) - 1)
    usable &= (time <= sections.end_s[section]) & (sections.tilt_sigma_rad[section] < _TILT_KNOWN_RAD)
    late = track.field_lag_s + float(fit.state[LAG])
    tilting = np.interp(time - late, record.time_s, record.tilt_rate_radps) - 1.3 * record.noise_radps
    slow = usable & (down[:, 2] > _LEAST_UPRIGHT)
    slow &= np.hypot(record.rate_at(time - late), np.maximum(tilting, 0.0)) < _SLOW_RADPS
    if int(slow.sum()) < 2:
        return 0.0
    time, section = time[slow], section[slow]
    heading = np.asarray(tilt_compensated_heading(field_mgauss[slow], -down[slow]))
    drift = np.interp(time, sections.middle_s, fit.headings_rad - sections.turned_rad)
    off = np.asarray(wrap_pi(heading - drift - record.angle_at(time - late)))
    sound = fit.sound[section]
    lasted = np.maximum(sections.end_s - sections.start_s, 1.0)
    visit = sound / (sections.repeats * lasted)[section]
    off = np.asarray(wrap_pi(off - np.angle((visit * np.exp(1j * off)).sum())))
    _, second = np.unique(np.floor(time), return_inverse=True)
    weight = np.bincount(second, sound)
    readings = np.bincount(second)
    kept = weight > 0.3 * readings
    if int(kept.sum()) < _FEWEST_S:
        return 0.0
    mean = np.bincount(second, sound * off)[kept] / weight[kept]
    fresh = float(sections.samples.sum() / max((sections.end_s - sections.start_s).sum(), 1e-9))
    dip = float(fit.state[VERTICAL] / fit.state[HORIZONTAL])
    tilt = np.bincount(second, sections.tilt_sigma_rad[section])[kept] / readings[kept]
    noise = (sections.noise_mgauss / float(fit.state[HORIZONTAL])) ** 2 / np.minimum(
        readings[kept], max(fresh, 1.0)
    ) + (tilt * dip) ** 2
    # Long standing must not hide what the turns show, nor the turns what long standing shows.
    by_visit = (np.bincount(second, visit)[kept] / readings[kept]).clip(1e-12)
    return max(_beyond_noise(mean, noise, share) for share in (by_visit, np.ones_like(by_visit)))


def _beyond_noise(off_rad: FloatArray, variance: FloatArray, weights: FloatArray) -> float:
    """Return the weighted rms of what noise of a given variance does not explain."""
    share = weights / weights.sum()
    chance = float(share @ variance) * (1.0 + _CHANCE * math.sqrt(2.0 * float(share @ share)))
    return math.sqrt(max(float(share @ off_rad**2) - chance, 0.0))


def motors_left_rad(sections: Sections, fit: MotionFit, left_mgauss: FloatArray) -> float:
    """Return the heading scatter by motors' fields (L, 3) per unit of load that are not taken out, radians.

    What chance gives the fit is not counted.
    """
    share = 1.0 / sections.repeats
    left = np.average((sections.loads @ left_mgauss) ** 2, axis=0, weights=share)
    chance = np.average(motors_variance(sections.loads, fit), axis=0, weights=share)
    beyond = float(np.maximum(left - _CHANCE * chance, 0.0)[:2].sum())
    horizontal = float(fit.state[HORIZONTAL]) * float(np.trace(fit.gain[:2, :2])) / 2.0
    return math.sqrt(0.5 * beyond) / abs(horizontal)
