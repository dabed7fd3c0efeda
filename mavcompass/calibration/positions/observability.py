"""What a motion can and cannot determine, and the one further pose or turn that would help most."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.model import NAMES, OFFSET, HeadingError
from mavcompass.calibration.observation import FourPositionData, Step
from mavcompass.calibration.positions.problem import PositionProblem, fit_positions
from mavcompass.calibration.rigid import DEFAULT_PRIOR, IronPrior
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray

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
    tilts = [(0.0, 0.0)]
    if may_tilt:
        lean = math.radians(15.0)
        tilts += [(lean, 0.0), (-lean, 0.0), (0.0, lean), (0.0, -lean)]
    problem = PositionProblem.of(data, in_force, earth, prior)
    state = fit_positions(problem).state
    best: NextPose | None = None
    for turn in np.arange(0.0, 2.0 * math.pi, math.radians(45.0)):
        for roll, pitch in tilts:
            level, tilted = _sigma_with(problem, state, data, float(turn), roll, pitch)
            if best is None or math.hypot(level, tilted) < math.hypot(
                best.sigma_level_rad, best.sigma_tilted_rad
            ):
                words = _words(float(turn), roll, pitch)
                best = NextPose(float(turn), roll, pitch, level, tilted, words)
    assert best is not None
    return best


def _sigma_with(
    problem: PositionProblem,
    state: FloatArray,
    data: FourPositionData,
    turn: float,
    roll: float,
    pitch: float,
) -> tuple[float, float]:
    """Predict the heading's rms sigma, level and at 15 degrees, with one more pose."""
    extended = problem.with_pose(state, turn, roll, pitch, _usual_step(data))
    covariance = fit_positions(extended).covariance
    lean = math.radians(15.0)
    error = HeadingError(state, covariance[:9, :9])
    return error.rms_rad(), math.hypot(error.rms_rad(lean, 0.0), error.rms_rad(0.0, lean)) / math.sqrt(2.0)


def _usual_step(data: FourPositionData) -> Step:
    sigma = float(np.median([s.sigma_rad for s in data.steps]))
    return Step(0.0, sigma, float(np.median([s.duration_s for s in data.steps])))


def _words(turn: float, roll: float, pitch: float) -> str:
    place = (
        "at the last heading" if turn == 0.0 else f"{math.degrees(turn):.0f} degrees clockwise from the last"
    )
    if roll:
        return f"One more position {place}, leaning {'right' if roll > 0.0 else 'left'} by 15 degrees."
    if pitch:
        return f"One more position {place}, nose {'up' if pitch > 0.0 else 'down'} by 15 degrees."
    return f"One more level position {place}."
