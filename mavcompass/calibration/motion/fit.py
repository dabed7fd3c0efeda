"""Fit a compass to a motion: sections (S1), the gyro's turns between them, the prior, all at once.

Hard iron, gains, motor field, field lag, the gyro's scale and bias, the Earth's field and the heading of
every section are estimated together, maximum a posteriori, as in the four-position fit; nothing in it is the
autopilot's yaw. How far off each section may be (`misfit`) is estimated with the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mavcompass.calibration.first_state import FirstState, first_state, rough_field
from mavcompass.calibration.model import (
    HEADINGS,
    HORIZONTAL,
    LAG,
    MOTOR,
    VERTICAL,
    HeadingError,
    by_tilt,
)
from mavcompass.calibration.motion.misfit import (
    ModelError,
    model_error,
    roots_of,
    section_variance,
    soundness,
)
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.rigid import Fit, IronPrior, prior_rows, settle
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

# Of the motor field per unit of load, each axis: amperes, and the whole throttle.
_MOTOR_SIGMA = {"current": 10.0, "throttle": 100.0, "none": 1e-6}
_ROUNDS, _STEPS_A_ROUND = 12, 10
_FEWEST = 4


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
    x, rules, _ = begin(sections, earth, prior, load_source, in_force)
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


def begin(
    sections: Sections,
    earth: EarthField | None = None,
    prior: IronPrior | None = None,
    load_source: str = "none",
    in_force: FieldCorrection | None = None,
) -> FirstState:
    """Tell where `fit_motion` begins, which costs a fiftieth of it."""
    field = rough_field(sections.mean_mgauss, earth, in_force or FieldCorrection())
    gyro_sigma = (sections.scale_sigma, sections.bias_sigma_radps)
    beliefs, motor_sigma = prior or IronPrior(), _MOTOR_SIGMA[load_source]
    rules = prior_rows(len(sections), beliefs, earth, in_force, field[1], gyro_sigma, motor_sigma)
    return first_state(sections, rules, field)


def leaning_error(sections: Sections, fit: MotionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same all along, adds to the state, (P, 2).

    By roll and by pitch, one sigma each; see `rigid.Fit.common_error`.
    """
    leaning = by_tilt(sections.mapping, fit.state, fit.headings_rad) * sections.tilt_bias_rad
    return fit.common_error(leaning)


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
    late = replace(sections, mapping=sections.mapping + fit.state[LAG] * sections.by_lag)
    return sections.field(np.concatenate([fit.state[:HEADINGS], level_headings(late, fit)]))[0]
