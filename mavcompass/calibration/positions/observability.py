"""What a motion can and cannot determine, and the one further pose or turn that would help most."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.model import HEADINGS, NAMES, OFFSET, HeadingError
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions.problem import PositionProblem, fit_positions
from mavcompass.calibration.rigid import DEFAULT_PRIOR, Fit, IronPrior, Readings, covariance_of
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, level_to_body

_OFFSET_KNOWN_MGAUSS = 10.0
_GAIN_KNOWN = 0.04
# As the report names offsets and gains, by their places in the state.
_SCALES, _CROSSES = ("scale_x", "scale_y", "scale_z"), ("cross_xy", "cross_xz", "cross_yz")
_REPORTED = (*NAMES[OFFSET], *_SCALES, *_CROSSES)


def unobserved(covariance: FloatArray, prior: IronPrior = DEFAULT_PRIOR) -> tuple[str, ...]:
    """List the quantities that a fit could not determine: what is said of them is the prior's opinion.

    "mounting_yaw", a turn of the whole compass about the vertical, shows in no relative measurement.
    """
    hidden = [_REPORTED[place] for place in hardly_known(covariance, prior)]
    return (*hidden, "mounting_yaw")


def hardly_known(covariance: FloatArray, prior: IronPrior = DEFAULT_PRIOR) -> NDArray[np.intp]:
    """Return the places of offsets and gains that a fit of this covariance could not determine."""
    sigma = np.sqrt(np.maximum(np.diag(covariance)[:9], 0.0))
    limits = [_OFFSET_KNOWN_MGAUSS] * 3 + [_GAIN_KNOWN] * 3 + [0.5 * prior.cross_sigma] * 3
    return np.flatnonzero(sigma > np.array(limits))


@dataclass(frozen=True, slots=True)
class NextPose:
    """Hold a suggestion: a further position and what it would do to the heading's sigma.

    Attributes:
        turn_rad: from the last position, clockwise. roll_rad, pitch_rad: its tilt.
        sigma_level_rad, sigma_tilted_rad: heading sigma with it, level and at 15 degrees of tilt, rms.
        words: what to do, in a sentence.
    """

    turn_rad: float
    roll_rad: float
    pitch_rad: float
    sigma_level_rad: float
    sigma_tilted_rad: float
    words: str


def next_pose(
    data: FourPositionData,
    in_force: FieldCorrection = IDENTITY,
    earth: EarthField | None = None,
    prior: IronPrior = DEFAULT_PRIOR,
    may_tilt: bool = True,
) -> NextPose:
    """Find the one further pose that lowers the heading's sigma most, level and tilted together.

    Tried are turns in steps of 45 degrees, level and (where the vehicle may be tilted) with 15 degrees
    of roll or pitch. Only covariances are needed, so the search works before the pose is taken.
    Raises PoorCalibration for data that `solve_four_positions` would refuse too.
    """
    tilts, lean = [(0.0, 0.0)], math.radians(15.0)
    if may_tilt:
        tilts += [(lean, 0.0), (-lean, 0.0), (0.0, lean), (0.0, -lean)]
    problem = PositionProblem.of(data, in_force, earth, prior)
    fit = fit_positions(problem)
    best: NextPose | None = None
    for turn in np.arange(0.0, 2.0 * math.pi, math.radians(45.0)):
        for roll, pitch in tilts:
            error = HeadingError(fit.state, _covariance_with(problem, fit, float(turn), roll, pitch)[:9, :9])
            level, tilted = error.rms_rad(), math.hypot(error.rms_rad(lean, 0.0), error.rms_rad(0.0, lean))
            tilted /= math.sqrt(2.0)
            if best is None or math.hypot(level, tilted) < math.hypot(
                best.sigma_level_rad, best.sigma_tilted_rad
            ):
                words = _words(float(turn), roll, pitch)
                best = NextPose(float(turn), roll, pitch, level, tilted, words)
    assert best is not None
    return best


def _covariance_with(
    problem: PositionProblem, fit: Fit, turn_rad: float, roll_rad: float, pitch_rad: float
) -> FloatArray:
    """Return the covariance of the state and of one more heading, its pose as certain as the best so far."""
    readings, known = problem.readings, fit.state.size
    pair = Readings(
        middle_s=np.array([0.0, np.median(np.diff(readings.middle_s))]),
        mean_mgauss=np.zeros((2, 3)),
        mapping=level_to_body(np.array([0.0, roll_rad]), np.array([0.0, pitch_rad])),
        by_lag=np.zeros((2, 3, 3)),
        load=np.zeros(2),
        turned_rad=np.array([0.0, turn_rad]),
        step_sigma_rad=np.median(readings.step_sigma_rad, keepdims=True),
    )
    state = np.append(fit.state[:HEADINGS], fit.state[-1] + pair.turned_rad)
    (_, by), (_, by_turn) = pair.field(state), pair.turns(state)
    best = int(np.argmin(np.trace(sum(problem.parts.values()), axis1=1, axis2=2)))
    rows = np.zeros((4, known + 1))
    rows[:, [*range(HEADINGS), known - 1, known]] = np.concatenate([problem.whiten[best] @ by[1], by_turn])
    return covariance_of(np.concatenate([np.pad(fit.jacobian, ((0, 0), (0, 1))), rows]))


def _words(turn: float, roll: float, pitch: float) -> str:
    place = (
        "at the last heading" if turn == 0.0 else f"{math.degrees(turn):.0f} degrees clockwise from the last"
    )
    if roll:
        return f"One more position {place}, leaning {'right' if roll > 0.0 else 'left'} by 15 degrees."
    if pitch:
        return f"One more position {place}, nose {'up' if pitch > 0.0 else 'down'} by 15 degrees."
    return f"One more level position {place}."
