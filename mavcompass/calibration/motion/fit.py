"""Fit a compass to a motion: sections (S1), the gyro's turns between them, the prior, all at once.

Hard iron, gains, motor field, field lag, the gyro's scale and bias, the Earth's field and the heading of
every section are estimated together, maximum a posteriori, as in the four-position fit; nothing in it is the
autopilot's yaw. How far off each section may be is estimated with the rest: noise, tilt, what passed by, and
an error of the model.

What the sections contradict beyond their noise is an error of the model (S2), alike in all of them and of two
kinds: a field that is not the Earth's, of one size on each axis; and an attitude that is off (a hand that
jerks, a gust), which turns the field and leaves its length. How much there is of each are variance
components, by restricted maximum likelihood (Patterson and Thompson 1971). Sections far out (a passing
magnet) are believed by how likely they are to be sound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mavcompass.calibration.first_state import FirstState, first_state, rough_field
from mavcompass.calibration.model import (
    GAIN,
    HEADINGS,
    HORIZONTAL,
    LAG,
    VERTICAL,
    HeadingError,
    by_tilt,
    gain_matrix,
)
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.rigid import (
    Fit,
    PriorRows,
    assembled,
    covariance_of,
    prior_rows,
    settle,
)
from mavcompass.chance import chance_of_more
from mavcompass.correction import MotorSource
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray
from mavcompass.heading.compute import level_field

# Of the motor field per unit of load, each axis: amperes, the whole throttle, a motor's largest output.
_MOTOR_SIGMA = {"current": 10.0, "throttle": 100.0, "outputs": 100.0, "none": 1e-6}
_ROUNDS, _STEPS_A_ROUND = 12, 10
_FEWEST = 4
# Before the data: one section in twenty stands beside something magnetic, of this size on each axis.
_DISTURBED_BEFORE, _DISTURBED_MGAUSS = 0.05, 40.0
# More disturbed sections than this, or more of the time, are no exceptions.
_MOST_DISTURBED = 0.3
# As often chance alone leaves as much.
_BY_CHANCE = 0.05
# With a larger error of the model there is nothing to refine.
_HOPELESS_MGAUSS, _LOST_RAD = 500.0, 1.0
# Fisher's steps settle in three to five.
_SCORINGS = 12
_AXES = np.eye(3)


@dataclass(frozen=True, slots=True)
class ModelError:
    """Hold the error of the model in a section.

    Attributes:
        mgauss: a field on each axis, 1 sigma.
        attitude_rad: a turn about each axis, 1 sigma, beyond what the source of roll and pitch says.
    """

    mgauss: float = 0.0
    attitude_rad: float = 0.0

    @classmethod
    def at_first(cls, residual_mgauss: FloatArray) -> ModelError:
        """Return the size of the first residuals' inner half, so that no outlier rules the start."""
        return cls(min(float(np.median(np.abs(residual_mgauss))) / 0.6745, _HOPELESS_MGAUSS))

    @property
    def is_hopeless(self) -> bool:
        """Tell whether there is nothing to refine."""
        return self.mgauss >= _HOPELESS_MGAUSS

    def is_near(self, other: ModelError) -> bool:
        """Tell whether two differ by nothing that matters."""
        attitude = abs(self.attitude_rad - other.attitude_rad) < 0.02 * other.attitude_rad + 1e-4
        return attitude and abs(self.mgauss - other.mgauss) < 0.02 * other.mgauss + 0.01


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit(Fit):
    """Hold the fit of K sections.

    Attributes:
        variance_mgauss2: of the residuals by noise, tilt and model error, (K, 3, 3).
        error: of the model, in each section; none where chance explains the residuals.
    """

    variance_mgauss2: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    error: ModelError = field(default_factory=ModelError)

    @property
    def horizontal_mgauss(self) -> float:
        """Return the horizontal field as the axis that shows most of it reads it."""
        return abs(float(self.state[HORIZONTAL])) * float(np.abs(self.gain[:2, :2]).max())

    @property
    def error_mgauss(self) -> float:
        """Return the error of the model on an axis, of both kinds together, rms."""
        total = math.hypot(self.state[HORIZONTAL], self.state[VERTICAL])
        return math.hypot(self.error.mgauss, math.sqrt(2.0 / 3.0) * total * self.error.attitude_rad)

    @property
    def information(self) -> FloatArray:
        """Return the inverse of the covariance."""
        return np.asarray(self.jacobian.T @ self.jacobian)

    @property
    def log_evidence(self) -> float:
        """Return the log of the readings' chance by this model (Laplace), but for what all fits share."""
        roots = np.diagonal(self.roots, axis1=1, axis2=2)
        return float(np.log(roots).sum() - 0.5 * np.linalg.slogdet(self.information)[1]) - self.cost


def fit_motion(recorded: Recorded, sections: Sections, load_source: MotorSource = "none") -> MotionFit:
    """Fit a compass to sections of its recording, K of them; `load_source` is what their load is.

    Without a place the Earth's field is estimated, and only the direction of its horizontal part counts.
    Raises PoorCalibration for fewer than four sections, or where the field does not turn with the vehicle.
    """
    if len(sections) < _FEWEST:
        raise PoorCalibration(
            f"Only {len(sections)} stretches of the recording have compass and gyro together.",
            "Record both at 10 Hz or more, and turn the vehicle through a full circle.",
        )
    x, rules, _ = begin(recorded, sections, load_source)
    error = ModelError.at_first(sections.field(x)[0])
    sound = np.ones(len(sections))
    for _ in range(_ROUNDS):
        variance = section_variance(sections, x, error)
        x = settle(sections, x, roots_of(variance, sound), rules, _STEPS_A_ROUND)
        residual, _ = sections.field(x)
        # How much a section counts beside others of its visit says nothing of how far out it is.
        fresh = soundness(sections, residual, section_variance(sections, x, error, weighed=False))
        grown = model_error(sections, x, error, fresh, rules)
        settled = grown.is_near(error) and float(np.abs(fresh - sound).max()) < 0.02
        error, sound = grown, fresh
        if settled or error.is_hopeless:
            break
    variance = section_variance(sections, x, error)
    fit = MotionFit.of(sections, x, roots_of(variance, sound), rules, sound)
    return replace(fit, variance_mgauss2=variance, error=error)


def begin(recorded: Recorded, sections: Sections, load_source: MotorSource = "none") -> FirstState:
    """Tell where `fit_motion` begins, which costs a fiftieth of it."""
    earth, prior, in_force = recorded.earth, recorded.prior, recorded.in_force
    field = rough_field(sections.mean_mgauss, earth, in_force)
    gyro_sigma = (sections.scale_sigma, sections.bias_sigma_radps)
    motor_sigma = motor_sigma_of(sections, load_source)
    rules = prior_rows(sections.loads.shape, prior, earth, in_force, field[1], gyro_sigma, motor_sigma)
    return first_state(sections, rules, field)


def motor_sigma_of(sections: Sections, load_source: MotorSource) -> float:
    """Return what the prior takes for the size of the motors' field per unit of load."""
    unit = float((sections.loads + sections.loads_mean).max()) if load_source == "outputs" else 1.0
    return _MOTOR_SIGMA[load_source] / unit


def motors_variance(loads: FloatArray, fit: MotionFit) -> FloatArray:
    """Return what is not known of the motors' field at loads (N, L), each axis squared, (N, 3)."""
    one = fit.motor.reshape(-1, 3).T
    covariance = fit.covariance[one[:, :, np.newaxis], one[:, np.newaxis]]
    return np.einsum("nl,alm,nm->na", loads, covariance, loads)


def leaning_error(sections: Sections, fit: MotionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same all along, adds to the state, (P, 2).

    By roll and by pitch, one sigma each; see `rigid.Fit.common_error`.
    """
    leaning = by_tilt(sections.mapping, fit.state, fit.headings_rad) * sections.tilt_bias_rad
    return fit.common_error(leaning)


def sigma_of(fit: MotionFit) -> float:
    """Return the level heading's sigma by a fit's covariance alone, rms over the circle, radians."""
    return HeadingError(fit.state[:11], fit.covariance[:9, :9]).rms_rad()


def level_headings(sections: Sections, fit: MotionFit, loads_shift: FloatArray | float = 0.0) -> FloatArray:
    """Return the headings that a fit makes of the readings of sections, (K,), radians.

    `loads_shift` are the mean loads of the fit's own sections less those of these, (L,).
    """
    motors = (sections.loads - loads_shift) @ fit.motors_mgauss
    raw = sections.mean_mgauss - fit.offset_mgauss - motors
    field = np.einsum("kji,kj->ki", sections.mapping, raw @ np.linalg.inv(fit.gain))
    return np.arctan2(-field[:, 1], field[:, 0])


def residual_of(sections: Sections, fit: MotionFit) -> FloatArray:
    """Return what a fit leaves of other sections of the same recording, (K, 3), at their best headings."""
    late = replace(sections, mapping=sections.mapping + fit.state[LAG] * sections.by_lag)
    further = fit.state[HEADINGS + len(fit.sound) :]
    return sections.field(np.concatenate([fit.state[:HEADINGS], level_headings(late, fit), further]))[0]


# --- how far off a section may be -------------------------------------------------------------------


def section_variance(
    sections: Sections, x: FloatArray, error: ModelError, weighed: bool = True
) -> FloatArray:
    """Return the covariance of each section's mean, (K, 3, 3): noise, whole numbers, tilt, model error.

    `weighed`: what the sections of one visit share is multiplied, so that together they count once.
    """
    psi = x[HEADINGS : HEADINGS + len(sections)]
    leaning = by_tilt(sections.mapping, x, psi) * sections.tilt_sigma_rad[:, np.newaxis, np.newaxis]
    alike = (error.mgauss**2 + sections.hidden_mgauss**2)[:, :, np.newaxis] * _AXES
    shared = leaning @ np.swapaxes(leaning, 1, 2) + error.attitude_rad**2 * _by_turn(sections, x) + alike
    white = (sections.noise_mgauss**2 / sections.samples)[:, np.newaxis, np.newaxis] * _AXES
    visits = sections.repeats if weighed else np.ones(len(sections))
    return np.asarray(visits[:, np.newaxis, np.newaxis] * shared + white)


def roots_of(variance: FloatArray, sound: FloatArray) -> FloatArray:
    """Return whitening matrices (K, 3, 3): sound and disturbed, weighed by their probability."""
    weight = np.linalg.inv(variance)
    loose = np.linalg.inv(variance + _DISTURBED_MGAUSS**2 * _AXES)
    p = sound[:, np.newaxis, np.newaxis]
    return np.swapaxes(np.linalg.cholesky(p * weight + (1.0 - p) * loose), 1, 2)


def soundness(sections: Sections, residual: FloatArray, variance: FloatArray) -> FloatArray:
    """Return each section's probability of not being disturbed, (K,); all sound where too many are not."""
    loose = variance + _DISTURBED_MGAUSS**2 * _AXES
    before = math.log(_DISTURBED_BEFORE / (1.0 - _DISTURBED_BEFORE))
    odds = before + 0.5 * (_square(residual, variance) - _square(residual, loose))
    odds = odds + 0.5 * (np.linalg.slogdet(variance)[1] - np.linalg.slogdet(loose)[1])
    sound = 1.0 / (1.0 + np.exp(np.clip(odds, -500.0, 500.0)))
    of_the_time = np.average(1.0 - sound, weights=sections.end_s - sections.start_s + 1e-9)
    return np.ones(len(residual)) if max((1.0 - sound).mean(), of_the_time) > _MOST_DISTURBED else sound


def model_error(
    sections: Sections, x: FloatArray, near: ModelError, sound: FloatArray, rules: PriorRows
) -> ModelError:
    """Find the likeliest model error of sound sections, (K,), from one that is `near`.

    None where chance alone makes the residuals as large in one case of twenty.
    """
    residual, by = sections.field(x)
    _, jacobian = assembled(sections, x, roots_of(section_variance(sections, x, near), sound), rules)
    plain = section_variance(sections, x, ModelError(), weighed=False)
    parts = np.stack([np.broadcast_to(_AXES, plain.shape), _by_turn(sections, x)])
    size2 = np.array([near.mgauss**2, near.attitude_rad**2])
    # So much of each residual the fit absorbs, in sigmas; the sections of a visit share it.
    root = _inverse_root(plain + np.tensordot(size2, parts, axes=1))
    absorbed = root @ by @ covariance_of(jacobian) @ np.swapaxes(by, 1, 2) @ root
    free = sound[:, np.newaxis, np.newaxis] * (_AXES - absorbed / sections.repeats[:, np.newaxis, np.newaxis])
    freedom = float(np.einsum("kii->", free))
    if chance_of_more(float((sound * _square(residual, plain)).sum()), round(freedom)) >= _BY_CHANCE:
        return ModelError()
    for _ in range(_SCORINGS):
        whitened = np.einsum("kij,kj->ki", root, residual)
        sized = root @ parts @ root
        score = np.einsum("k,ki,nkij,kj->n", sound, whitened, sized, whitened)
        score -= np.einsum("nkij,kji->n", sized, free)
        open_ = (size2 > 0.0) | (score > 0.0)
        information = np.einsum("nkij,mkji->nm", sized @ free, sized)[np.ix_(open_, open_)]
        step = np.zeros(2)
        step[open_] = np.linalg.lstsq(information, score[open_], rcond=1e-14)[0]
        before, size2 = size2, np.clip(size2 + step, 0.0, np.square((_HOPELESS_MGAUSS, _LOST_RAD)))
        root = _inverse_root(plain + np.tensordot(size2, parts, axes=1))
        if (np.abs(size2 - before) <= 0.01 * before).all():
            break
    return ModelError(*np.sqrt(size2).tolist())


def _inverse_root(variance: FloatArray) -> FloatArray:
    """Return the symmetric square root of the inverse of covariances (K, 3, 3)."""
    size, axes = np.linalg.eigh(variance)
    return np.asarray(axes / np.sqrt(size)[:, np.newaxis] @ np.swapaxes(axes, 1, 2))


def _by_turn(sections: Sections, x: FloatArray) -> FloatArray:
    """Return the covariance of the means by an attitude off by 1 radian about each axis, (K, 3, 3)."""
    level = level_field(x[HEADINGS : HEADINGS + len(sections)], x[HORIZONTAL], x[VERTICAL])
    body, gain = np.einsum("kij,kj->ki", sections.mapping, level), gain_matrix(x[GAIN])
    across = (body**2).sum(axis=1)[:, np.newaxis, np.newaxis] * _AXES
    across -= body[:, :, np.newaxis] * body[:, np.newaxis]
    return np.asarray(gain @ across @ gain)


def _square(residual: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray((residual * np.linalg.solve(variance, residual[:, :, np.newaxis])[:, :, 0]).sum(axis=1))
