"""The repeat test: turn back the other way, and see what was the compass and what was not.

A rigid compass reads the same at the same heading whichever way it was reached. What differs between
the two directions with the same sign everywhere along one axis or the other is hysteresis (of the iron
or of the gears); what differs at one heading only is something that came or went; what is equal in both but
does not fit the model is the calibration's own error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.calibration.model import HORIZONTAL
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions.four_positions import solve_four_positions
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.chance import chance_of_more
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, wrap_pi

RepeatCause = Literal["repeats", "hysteresis", "disturbance", "misfit"]
_UNLIKELY = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class RepeatTest:
    """Hold the comparison of a turn with its reverse.

    Attributes:
        cause: "repeats" (nothing beyond noise), "hysteresis" (a difference that turns with the
            direction), "disturbance" (one position differs), "misfit" (both turns agree with each other
            but not with a rigid compass).
        hysteresis_rad: half the heading difference between clockwise and counter-clockwise arrival.
        hysteresis_sigma_rad: its standard deviation.
        difference_rad: per position of the reverse turn, heading there less that of the forward turn at
            the same gyro angle, (K,). sigma_rad: of each.
        position: the disturbed position of the reverse turn (from 0), -1 otherwise.
        heading_rms_rad: half the rms difference: what does not repeat, as a heading error.
        words: the finding in a sentence.
    """

    cause: RepeatCause
    hysteresis_rad: float
    hysteresis_sigma_rad: float
    difference_rad: FloatArray
    sigma_rad: FloatArray
    position: int
    heading_rms_rad: float
    words: str


def repeat_test(
    forward: FourPositionData,
    backward: FourPositionData,
    in_force: FieldCorrection = IDENTITY,
    earth: EarthField | None = None,
    prior: IronPrior = DEFAULT_PRIOR,
) -> RepeatTest:
    """Calibrate on the forward turn and look at the backward one with that calibration.

    The backward turn starts where the forward one ended: its first dwell is at the heading of the forward
    turn's last. The calibrated field's own heading, less the gyro's angle, must stay the same; the gyro's
    bias shows as a drift with time and is fitted out.
    Raises PoorCalibration where the forward turn cannot be solved or the backward one has under three dwells.
    """
    if len(backward.dwells) < 3:
        raise PoorCalibration(
            f"The turn back has only {len(backward.dwells)} positions.", "Turn back through at least three."
        )
    fit = solve_four_positions(forward, in_force, earth, prior)
    headings = np.array([dwell.heading_rad(fit.correction) for dwell in backward.dwells])
    expected = fit.state[-1] + backward.turned_rad
    difference = np.asarray(wrap_pi(headings - expected))
    sigma = _sigma(backward, float(fit.state[HORIZONTAL]), fit.heading_sigma_rad)
    # Arriving the other way shifts all positions but the first, which was reached forward.
    constant, constant_sigma = _weighted(difference[1:], sigma[1:])
    rest = difference[1:] - constant
    chi_square = float(((rest / sigma[1:]) ** 2).sum())
    worst = 1 + int(np.argmax(np.abs(rest) / sigma[1:]))
    rms = 0.5 * math.sqrt(float((difference**2).mean()))
    cause, position, words = _judge(
        fit.consistency, constant, constant_sigma, chi_square, len(rest) - 1, worst, float(difference[worst])
    )
    return RepeatTest(cause, 0.5 * constant, 0.5 * constant_sigma, difference, sigma, position, rms, words)


def _sigma(data: FourPositionData, horizontal: float, calibration: float) -> FloatArray:
    """Add up each backward heading's sigma: the dwell's noise, the gyro since the start, the calibration."""
    noise = np.array(
        [
            math.sqrt(float(np.trace((d.covariance_mgauss2 + d.quantisation_mgauss2)[:2, :2])) / 2.0)
            / horizontal
            for d in data.dwells
        ]
    )
    steps = np.array([0.0, *np.cumsum([s.sigma_rad**2 for s in data.steps])])
    elapsed = np.array([0.0, *np.cumsum([s.duration_s for s in data.steps])])
    gyro = (
        steps + (elapsed * data.gyro_bias_sigma_radps) ** 2 + (data.turned_rad * data.gyro_scale_sigma) ** 2
    )
    return np.asarray(np.sqrt(noise**2 + gyro + calibration**2))


def _weighted(values: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    weights = 1.0 / sigma**2
    return float((weights * values).sum() / weights.sum()), 1.0 / math.sqrt(float(weights.sum()))


def _judge(
    consistency: float,
    constant: float,
    constant_sigma: float,
    chi_square: float,
    freedom: int,
    worst: int,
    worst_rad: float,
) -> tuple[RepeatCause, int, str]:
    if chance_of_more(chi_square, freedom) < _UNLIKELY:
        words = (
            f"Position {worst + 1} of the turn back is off by {math.degrees(worst_rad):+.1f} degrees: "
            "something magnetic came or went there. Repeat it."
        )
        return "disturbance", worst, words
    if abs(constant) > 3.0 * constant_sigma:
        words = (
            f"Every heading differs by {math.degrees(constant):+.1f} degrees with the direction of turning: "
            "hysteresis of steel near the compass, or play in its mount."
        )
        return "hysteresis", -1, words
    if consistency < _UNLIKELY:
        words = "Both turns agree, but not with a rigid compass: the calibration's model does not hold here."
        return "misfit", -1, words
    return "repeats", -1, "The turn back repeats the turn within its noise."
