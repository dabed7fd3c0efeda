"""Fit a compass to a motion: sections (S1), the gyro's turns between them, the prior, all at once.

Hard iron, gains, motor field, field lag, the gyro's scale and bias, the Earth's field and the heading of
every section are estimated together, maximum a posteriori, as in the four-position fit; nothing in it is the
autopilot's yaw. What the sections contradict beyond their noise is an error of the model, of the same size in
every section, and estimated with the rest; single sections far out (a passing magnet) are believed
by how likely they are to be sound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.calibration.model import (
    GAIN,
    HEADINGS,
    HORIZONTAL,
    LINEAR,
    MOTOR,
    OFFSET,
    VERTICAL,
    HeadingError,
    by_tilt,
    gain_matrix,
)
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.rigid import (
    IronPrior,
    PriorRows,
    assembled,
    common_error,
    covariance_of,
    prior_rows,
    settle,
)
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

# Of the motor field per unit of load, each axis: amperes, and the whole throttle.
_MOTOR_SIGMA = {"current": 10.0, "throttle": 100.0, "none": 1e-6}
_ROUNDS, _STEPS_A_ROUND = 8, 10
# Before the data: one section in twenty stands beside something magnetic, of this size on each axis.
_DISTURBED_BEFORE, _DISTURBED_MGAUSS = 0.05, 40.0
# More disturbed sections than this, or more of the time, are no exceptions.
_MOST_DISTURBED = 0.3
_FEWEST = 4
# With a larger error of the model there is nothing to refine.
_HOPELESS_MGAUSS = 500.0
_STARTS, _CLOSELY = 12, 11


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit:
    """Hold the fit of K sections.

    Attributes:
        state: 16 numbers named by `model.NAMES`, the lag, K headings. covariance: of it.
        residual_mgauss: measured less predicted, (K, 3).
        variance_mgauss2: of the residuals by noise, tilt and model error, (K, 3, 3).
        model_mgauss: the model error of a section, each axis; 0 where chance explains the residuals.
        sound: probability of each section not being disturbed, (K,).
        jacobian, whitened: rows of field (3 K) then turns (K - 1), as the fit weighed them: (R, P), (R,).
        information: the inverse of `covariance`.
        cost: half the squared whitened residuals, prior included; lower is likelier.
    """

    state: FloatArray
    covariance: FloatArray
    residual_mgauss: FloatArray
    variance_mgauss2: FloatArray
    model_mgauss: float
    sound: FloatArray
    jacobian: FloatArray
    whitened: FloatArray
    information: FloatArray
    cost: float

    @property
    def offset_mgauss(self) -> FloatArray:
        """Return the hard iron, (3,)."""
        return self.state[OFFSET]

    @property
    def gain(self) -> FloatArray:
        """Return the symmetric gain, (3, 3)."""
        return gain_matrix(self.state[GAIN])

    @property
    def horizontal_mgauss(self) -> float:
        """Return the horizontal field as the axis that shows most of it reads it."""
        return abs(float(self.state[HORIZONTAL])) * float(np.abs(self.gain[:2, :2]).max())

    @property
    def headings_rad(self) -> FloatArray:
        """Return the sections' magnetic headings, (K,)."""
        return self.state[HEADINGS:]


def fit_motion(
    sections: Sections,
    earth: EarthField | None = None,
    prior: IronPrior | None = None,
    load_source: str = "none",
    in_force: FieldCorrection | None = None,
) -> MotionFit:
    """Fit a compass to its sections.

    Args:
        sections: of the recording, K of them.
        earth: the Earth's field there; None estimates it, and only its horizontal part's direction counts.
        prior: what is known of compasses in general.
        load_source: what `sections.load` is: "current", "throttle" or "none".
        in_force: gives Z's offset where no world model does.

    Raises PoorCalibration for fewer than four sections, or where the field does not turn with the vehicle.
    """
    if len(sections) < _FEWEST:
        raise PoorCalibration(
            f"Only {len(sections)} stretches of the recording have compass and gyro together.",
            "Record both at 10 Hz or more, and turn the vehicle through a full circle.",
        )
    motor_sigma = _MOTOR_SIGMA[load_source]
    beliefs = prior or IronPrior()
    x, rules = first_state(sections, earth, beliefs, motor_sigma, in_force)
    model = _first_model_error(sections, x)
    sound = np.ones(len(sections))
    for _ in range(_ROUNDS):
        variance = section_variance(sections, x, model)
        x = settle(sections, x, _roots(variance, sound), rules, _STEPS_A_ROUND)
        residual, _ = sections.field(x)
        # How much a section counts beside others of its visit says nothing of how far out it is.
        fresh = _soundness(sections, residual, section_variance(sections, x, model, weighed=False))
        grown = _model_error(sections, x, residual, fresh, rules)
        settled = abs(grown - model) < 0.02 * model + 0.01 and float(np.abs(fresh - sound).max()) < 0.02
        model, sound = grown, fresh
        if settled or model > _HOPELESS_MGAUSS:
            break
    variance = section_variance(sections, x, model)
    roots = _roots(variance, sound)
    x = settle(sections, x, roots, rules)
    values, jacobian = assembled(sections, x, roots, rules)
    measured = 4 * len(sections) - 1
    return MotionFit(
        state=x,
        covariance=covariance_of(jacobian),
        residual_mgauss=sections.field(x)[0],
        variance_mgauss2=variance,
        model_mgauss=model,
        sound=sound,
        jacobian=jacobian[:measured],
        whitened=values[:measured],
        information=jacobian.T @ jacobian,
        cost=0.5 * float(values @ values),
    )


def section_variance(
    sections: Sections, x: FloatArray, model_mgauss: float, weighed: bool = True
) -> FloatArray:
    """Return the covariance of each section's mean, (K, 3, 3): noise, whole numbers, tilt, model error.

    `weighed`: what the sections of one visit share is multiplied, so that together they count once.
    """
    leaning = by_tilt(sections.mapping, x, x[HEADINGS:])
    tilt = leaning @ np.swapaxes(leaning, 1, 2)
    alike = (model_mgauss**2 + sections.hidden_mgauss**2)[:, :, np.newaxis] * np.eye(3)
    shared = tilt * sections.tilt_sigma_rad[:, np.newaxis, np.newaxis] ** 2 + alike
    white = (sections.noise_mgauss**2 / sections.samples)[:, np.newaxis, np.newaxis] * np.eye(3)
    return np.asarray(
        (sections.repeats if weighed else np.ones(len(sections)))[:, np.newaxis, np.newaxis] * shared + white
    )


def first_state(
    sections: Sections,
    earth: EarthField | None,
    prior: IronPrior,
    motor_sigma: float,
    in_force: FieldCorrection | None,
) -> tuple[FloatArray, PriorRows]:
    """Find a first state: the first heading is tried all round, the rest is linear then.

    Half a turn away and all gains negative the field is the same, and only the prior tells: near the best and
    opposite to it the heading is tried closely, so that what it is off by weighs less than that.
    """
    if earth is not None:
        horizontal, vertical = earth.horizontal_mgauss, float(earth.ned_mgauss[2])
    else:
        field = (in_force or FieldCorrection()).apply(sections.mean_mgauss)
        swing = np.percentile(field[:, :2], 95, axis=0) - np.percentile(field[:, :2], 5, axis=0)
        horizontal, vertical = max(0.5 * float(swing.max()), 1.0), float(np.median(field[:, 2]))
    rules = prior_rows(
        len(sections),
        prior,
        earth,
        in_force,
        vertical,
        (sections.scale_sigma, sections.bias_sigma_radps),
        motor_sigma,
    )
    x = np.zeros(HEADINGS + len(sections))
    x[GAIN], x[HORIZONTAL], x[VERTICAL] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), horizontal, vertical

    def tried(starts_rad: FloatArray) -> FloatArray:
        headings = starts_rad[:, np.newaxis] + sections.turned_rad - sections.turned_rad[0]
        return _likeliest(sections, x, headings, rules, 0.1 * horizontal)

    step = 2.0 * math.pi / _STARTS
    near = (
        tried(step * np.arange(_STARTS, dtype=np.float64))[HEADINGS] + np.linspace(-0.5, 0.5, _CLOSELY) * step
    )
    return tried(np.concatenate([near, near + math.pi])), rules


def _likeliest(
    sections: Sections, x: FloatArray, headings_rad: FloatArray, rules: PriorRows, noise: float
) -> FloatArray:
    """Solve for the linear part at several headings, (S, K), robustly; return the state of least cost."""
    residual, by = sections.linear(x, headings_rad)
    trials = len(headings_rad)
    by, residual = by.reshape(trials, -1, LINEAR.size) / noise, residual.reshape(trials, -1) / noise
    held, off = rules.rows[:, LINEAR], rules.of(x)
    found, weights = np.zeros((trials, LINEAR.size)), np.ones(residual.shape)
    for _ in range(3):
        weighed = np.swapaxes(by * weights[:, :, np.newaxis], 1, 2)
        pull = (weighed @ residual[:, :, np.newaxis])[:, :, 0] - (off + found @ held.T) @ held
        step = np.linalg.solve(weighed @ by + held.T @ held, pull[:, :, np.newaxis])
        found += step[:, :, 0]
        residual = residual - (by @ step)[:, :, 0]
        size = np.linalg.norm(residual.reshape(trials, -1, 3), axis=2)
        usual = np.maximum(2.0 * np.median(size, axis=1, keepdims=True), 1e-6 / noise)
        trust = 1.0 / np.maximum(1.0, size / usual)
        weights = np.repeat(trust, 3, axis=1)
    cost = (trust * size**2).sum(axis=1) + ((off + found @ held.T) ** 2).sum(axis=1)
    best = int(np.argmin(cost))
    x = x.copy()
    x[LINEAR] += found[best]
    x[HEADINGS:] = headings_rad[best]
    return x


def leaning_error(sections: Sections, fit: MotionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same all along, adds to the state, (P, 2).

    By roll and by pitch, one sigma each; see `rigid.common_error`.
    """
    leaning = by_tilt(sections.mapping, fit.state, fit.headings_rad) * sections.tilt_bias_rad
    return common_error(_roots(fit.variance_mgauss2, fit.sound) @ leaning, fit.covariance, fit.jacobian)


def sigma_of(fit: MotionFit) -> float:
    """Return the level heading's sigma by a fit's covariance alone, rms over the circle, radians."""
    return HeadingError(fit.state[:11], fit.covariance[:9, :9]).rms_rad()


def level_headings(sections: Sections, fit: MotionFit, load_shift: float = 0.0) -> FloatArray:
    """Return the headings that a fit makes of the readings of sections, (K,), radians.

    `load_shift` is the mean load of the fit's own sections less that of these.
    """
    motors = (sections.load - load_shift)[:, np.newaxis] * fit.state[MOTOR]
    raw = sections.mean_mgauss - fit.offset_mgauss - motors
    field = np.einsum("kji,kj->ki", sections.mapping, raw @ np.linalg.inv(fit.gain))
    return np.arctan2(-field[:, 1], field[:, 0])


def residual_of(sections: Sections, fit: MotionFit) -> FloatArray:
    """Return what a fit leaves of other sections of the same recording, (K, 3), at their best headings."""
    x = np.concatenate([fit.state[:HEADINGS], level_headings(sections, fit)])
    return sections.field(x)[0]


def _roots(variance: FloatArray, sound: FloatArray) -> FloatArray:
    """Return whitening matrices (K, 3, 3): sound and disturbed, weighed by their probability."""
    weight = np.linalg.inv(variance)
    loose = np.linalg.inv(variance + _DISTURBED_MGAUSS**2 * np.eye(3))
    p = sound[:, np.newaxis, np.newaxis]
    return np.swapaxes(np.linalg.cholesky(p * weight + (1.0 - p) * loose), 1, 2)


def _soundness(sections: Sections, residual: FloatArray, variance: FloatArray) -> FloatArray:
    """Return each section's probability of not being disturbed, (K,); all sound where too many are not."""
    loose = variance + _DISTURBED_MGAUSS**2 * np.eye(3)
    before = math.log(_DISTURBED_BEFORE / (1.0 - _DISTURBED_BEFORE))
    odds = before + 0.5 * (_square(residual, variance) - _square(residual, loose))
    odds = odds + 0.5 * (np.linalg.slogdet(variance)[1] - np.linalg.slogdet(loose)[1])
    sound = 1.0 / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
    of_the_time = np.average(1.0 - sound, weights=sections.end_s - sections.start_s + 1e-9)
    return np.ones(len(residual)) if max((1.0 - sound).mean(), of_the_time) > _MOST_DISTURBED else sound


def _square(residual: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray((residual * np.linalg.solve(variance, residual[:, :, np.newaxis])[:, :, 0]).sum(axis=1))


def _first_model_error(sections: Sections, x: FloatArray) -> float:
    """Return the size of the first residuals' inner half, so that no outlier rules the start."""
    residual, _ = sections.field(x)
    return min(float(np.median(np.abs(residual))) / 0.6745, _HOPELESS_MGAUSS)


def _model_error(
    sections: Sections, x: FloatArray, residual: FloatArray, sound: FloatArray, rules: PriorRows
) -> float:
    """Find the model error with which the sound residuals are as large as their degrees of freedom.

    0 where chance alone makes them as large in one case of twenty.
    """
    absorbed = _absorbed(sections, x, sound, rules)
    freedom = float(3.0 * sound.sum() + len(sections) - 1 - absorbed)
    turns, _ = sections.turns(x)
    if freedom < 1.0:
        return 0.0
    # Turns that are bent beyond their noise are pulled by sections: these will, with their error, let go.
    given = min(float(turns @ turns), float(turns.size))

    noise, axes = np.linalg.eigh(section_variance(sections, x, 0.0, weighed=False))
    along = sound[:, np.newaxis] * np.einsum("kij,ki->kj", axes, residual) ** 2

    def excess(size: float, wanted: float) -> float:
        return float((along / (noise + size**2)).sum()) + given - wanted

    if excess(0.0, _chance_limit(freedom)) <= 0.0:
        return 0.0
    low, high = 0.0, 1.0
    while excess(high, freedom) > 0.0 and high < _HOPELESS_MGAUSS:
        low, high = high, 2.0 * high
    for _ in range(25):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle, freedom) > 0.0 else (low, middle)
    return high


def _absorbed(sections: Sections, x: FloatArray, sound: FloatArray, rules: PriorRows) -> float:
    """Count what the fit absorbs of the measurements: parameters less what the prior holds."""
    roots = _roots(section_variance(sections, x, 1.0), sound)
    _, jacobian = assembled(sections, x, roots, rules)
    return x.size - float(((rules.rows @ covariance_of(jacobian)) * rules.rows).sum())


def _chance_limit(freedom: float) -> float:
    """Return what a chi-square exceeds once in twenty (Wilson and Hilferty)."""
    third = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - third + 1.645 * math.sqrt(third)) ** 3
