"""What the chosen effects leave on all rows, with the noise that this recording shows.

Numbers that are rounded, saturated or scattered more than the floor's have another noise than the
floor's. What is left is judged under that noise; otherwise each of these would look like an unknown cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import (
    Floor,
    Scatter,
    find_scatter,
    measured_noise,
    noise_with,
)
from mavcompass.gap.replay import Noise
from mavcompass.gap.selection.posterior import Identified
from mavcompass.gap.traces import Traces
from mavcompass.simulation.effects.effect import LIMIT
from mavcompass.simulation.physics.signals import Reading

_LEAST_MGAUSS = 0.3
_SEED = 20260102


@dataclass(frozen=True, slots=True, eq=False)
class Remainder:
    """Hold the chosen effects refitted on all rows, and extra scatter if there is some.

    `comparable` is False where the readings' own noise cannot be compared with the floor's.
    """

    problem: Problem
    fit: Fit
    scatter: Scatter | None
    comparable: bool


def with_white(noise: Noise, variance_mgauss2: float) -> Noise:
    """Add white scatter to the compass's noise: the rounding's, step^2 / 12, or what single readings show."""
    mag = noise["mag"]
    sigma, rms = (np.sqrt(values**2 + variance_mgauss2) for values in (mag.sigma, mag.rms))
    return {**noise, "mag": replace(mag, sigma=sigma, rms=rms)}


def what_is_left(identified: Identified, floor: Floor, names: frozenset[str], traces: Traces) -> Remainder:
    """Refit the chosen effects on all rows; look for extra scatter, and put it into the noise."""
    step_mgauss = traces.step_mgauss
    replay, chosen = identified.problem.replay, identified.fit
    noise = with_white(floor.noise, step_mgauss**2 / 12.0) if step_mgauss > 0.0 else floor.noise
    problem = Problem(replay, noise, replay.valid, floor.prior)
    fit = problem.refit(chosen)
    # Moments and thresholds lie between readings: all rows place them better than the training rows.
    if any(term.effect.moves for term in fit.terms):
        fit = identified.search.on(problem).polished(fit)
    if step_mgauss > 0.0:
        return _unrounded(problem, fit, floor, step_mgauss)
    scatter = find_scatter(problem, fit, names, floor, traces.excess_mgauss2)
    if scatter is None:
        # A saturated reading has no scatter.
        return Remainder(problem, fit, None, fit.value(LIMIT) is None)
    noisy = Problem(problem.replay, noise_with(problem, fit, scatter), problem.rows, floor.prior)
    return Remainder(noisy, noisy.refit(fit), scatter, False)


def _unrounded(problem: Problem, fit: Fit, floor: Floor, step_mgauss: float) -> Remainder:
    """Draw what coarse numbers may have been before they were rounded, given the model and the floor.

    If the model is true, the drawn errors are exactly the floor's (randomised quantile residuals, Dunn and
    Smyth 1996), however coarse the steps are; errors of rounding themselves go with the field.
    """
    replay = problem.replay
    measured = replay.measured
    sigma = floor.noise["mag"].rms
    if not floor.measured:
        # The scatter that was read off the rounded numbers holds that of the rounding.
        sigma = np.sqrt(np.maximum(sigma**2 - step_mgauss**2 / 12.0, _LEAST_MGAUSS**2))
    drawn = _before_rounding(measured.mag_mgauss, problem.predict(fit).mag_mgauss, sigma, step_mgauss)
    fine = replace(replay, measured=Reading(drawn, measured.acc_mps2, measured.gyro_radps))
    fresh = Problem(fine, problem.noise, problem.rows, problem.prior)
    noise = {**floor.noise, "mag": measured_noise(fresh, fit)["mag"]}
    judged = Problem(fine, noise, problem.rows, problem.prior)
    return Remainder(judged, judged.refit(fit), None, False)


def _before_rounding(
    rounded: FloatArray, predicted: FloatArray, sigma: FloatArray, step_mgauss: float
) -> FloatArray:
    """Draw normal values about a prediction, each inside the step that its rounded value stands for."""
    from scipy.special import ndtr, ndtri

    low, high = rounded - 0.5 * step_mgauss, rounded + 0.5 * step_mgauss
    p_low, p_high = ndtr((low - predicted) / sigma), ndtr((high - predicted) / sigma)
    share = np.random.default_rng(_SEED).random(rounded.shape)
    p = np.clip(p_low + share * (p_high - p_low), 1e-12, 1.0 - 1e-12)
    return np.asarray(np.clip(predicted + sigma * ndtri(p), low, high))
