"""The four-position calibration at its best: a maximum-a-posteriori fit of still positions.

Estimated together: hard iron, gains and cross terms, the first heading, the angles really turned, the
gyro's scale and bias, the Earth's field and the field of a changing current. Measured: the mean field
of each dwell with its covariance, the gyro's step angles, gravity for the tilt, and the world model
where the place is known. The autopilot's own yaw is not used. Three positions suffice, any steps and
either direction will do, and more turns only help. Equations (M1) and (M2) stand in `model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.cross_terms import weigh_cross_terms
from mavcompass.calibration.model import (
    ACCELEROMETER,
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADINGS,
    HORIZONTAL,
    MOTOR,
    NAMES,
    OFFSET,
    VERTICAL,
    HeadingError,
    gain_matrix,
    heading_gradient,
)
from mavcompass.calibration.observation import FourPositionData
from mavcompass.calibration.positions.problem import PositionProblem, fit_positions, weigh_disturbances
from mavcompass.calibration.rigid import (
    DEFAULT_PRIOR,
    Fit,
    IronPrior,
    Readings,
    covariance_of,
)
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray, level_to_body, wrap_two_pi

# Below this probability of the agreement the covariance is widened.
WIDENED_BELOW = 0.01
# A dwell with at least this probability of having been disturbed is named.
_SUSPECT = 0.05
# As the report names them; what the prior holds of the state counts for one of them.
_PARTS = ("noise", "step_angle", "tilt", ACCELEROMETER, "world_model", "quantisation", "disturbance", "prior")
# A row beyond these is a heading that was given; nowhere else does it appear.
GIVEN_HEADING = "given_heading"
_SOURCE_OF = {
    **dict.fromkeys((GYRO_SCALE, GYRO_BIAS), "step_angle"),
    **dict.fromkeys((HORIZONTAL, VERTICAL), "world_model"),
    **dict.fromkeys(range(MOTOR.start, MOTOR.stop), "disturbance"),
}
_OFFSET_KNOWN_MGAUSS = 10.0
_GAIN_KNOWN = 0.04
# As the report names offsets and gains, by their places in the state.
_SCALES, _CROSSES = ("scale_x", "scale_y", "scale_z"), ("cross_xy", "cross_xz", "cross_yz")
_REPORTED = (*NAMES[OFFSET], *_SCALES, *_CROSSES)


@dataclass(frozen=True, slots=True, eq=False)
class FourPositionsResult:
    """Hold the fit of the still positions.

    Attributes:
        correction: what to put in force, ArduPilot's meaning.
        state, covariance: all parameters, named by `names`; headings are magnetic.
        residual_mgauss: measured less predicted mean field, (K, 3).
        consistency: the probability of a worse agreement by chance, the likeliest disturbed dwell left out.
        disturbed_probability: of each dwell having been disturbed, (K,).
        disturbance_mgauss: how far the likeliest of them is from what the others predict.
        suspects: dwells (from 0) of which one may have been disturbed, most likely first.
        budget_rad: the heading's rms sigma by source; the squares add up to the whole.
        world_model: True where the Earth's field at the place was used.
        mirrored: True where the field turns against the gyro: a compass mounted upside down.
    """

    correction: FieldCorrection
    names: tuple[str, ...]
    state: FloatArray
    covariance: FloatArray
    residual_mgauss: FloatArray
    consistency: float
    disturbed_probability: FloatArray
    disturbance_mgauss: float
    suspects: tuple[int, ...]
    budget_rad: dict[str, float]
    world_model: bool
    mirrored: bool

    @property
    def heading_error(self) -> HeadingError:
        """Return the heading's uncertainty as a function of heading and tilt."""
        return HeadingError(self.state, self.covariance[:9, :9])

    @property
    def heading_sigma_rad(self) -> float:
        """Return the level heading's sigma, rms over the circle, by the calibration alone."""
        return self.heading_error.rms_rad()

    @property
    def residual_rms_mgauss(self) -> float:
        """Return what is left, over dwells and axes."""
        return math.sqrt(float((self.residual_mgauss**2).mean()))

    @property
    def raw_offset_mgauss(self) -> FloatArray:
        """Return the hard iron, (3,): raw = field + offset."""
        return self.state[OFFSET]

    @property
    def magnetic_headings_rad(self) -> FloatArray:
        """Return the magnetic heading of each dwell, (K,), in [0, 2 pi)."""
        return np.asarray(wrap_two_pi(self.state[HEADINGS:]))


def solve_four_positions(
    data: FourPositionData,
    in_force: FieldCorrection = IDENTITY,
    earth: EarthField | None = None,
    prior: IronPrior = DEFAULT_PRIOR,
) -> FourPositionsResult:
    """Fit a compass's correction to three or more still positions and the turns between them.

    Args:
        data: the dwells' raw field and the gyro's steps.
        in_force: the correction in force; it gives the Z offset where no world model does, and its
            motor term is carried over.
        earth: the Earth's field at the place; gives the scale and, with its sigma, Z.
        prior: what is known of compasses in general.

    Raises PoorCalibration for fewer than three positions or too little turning.
    """
    problem = PositionProblem.of(data, in_force, earth, prior)
    fit = fit_positions(problem)
    mixture = weigh_disturbances(problem, fit)
    best, consistency = mixture.best, mixture.best.chance
    # A worse agreement than chance gives, whichever dwell is blamed: the noise is not what it seemed.
    excess = max(best.chi_square / max(best.freedom, 1), 1.0) if consistency < WIDENED_BELOW else 1.0
    # The accelerometer's own error, the same in every dwell: on the level it looks like an offset.
    leaning = fit.common_error(problem.leaning)
    blend = weigh_cross_terms(mixture.state, excess * mixture.covariance, prior, leaning)
    state, covariance, _ = blend
    ranked = np.argsort(-mixture.probability)
    return FourPositionsResult(
        correction=_correction(state, in_force, earth is not None),
        names=(*NAMES, *(f"heading_{k + 1}" for k in range(len(data.dwells)))),
        state=state,
        covariance=covariance,
        residual_mgauss=fit.residual_mgauss,
        consistency=consistency,
        disturbed_probability=mixture.probability,
        disturbance_mgauss=float(mixture.size_mgauss[ranked[0]]),
        suspects=tuple(int(i) for i in ranked if mixture.probability[i] > _SUSPECT),
        budget_rad=heading_budget(problem, fit, blend),
        world_model=earth is not None,
        mirrored=problem.mirrored,
    )


def _correction(state: FloatArray, in_force: FieldCorrection, world_model: bool) -> FieldCorrection:
    """Turn the fitted state into a correction; the motor term in force is carried into its matrix.

    Without the world model neither the scale nor Z is known: the horizontal diagonals then average 1,
    and offset and diagonal of Z stay as they are in force.
    """
    matrix = np.linalg.inv(gain_matrix(state[GAIN]))
    offsets = -state[OFFSET]
    if not world_model:
        matrix = matrix * 2.0 / (matrix[0, 0] + matrix[1, 1])
        matrix[2, 2] = in_force.matrix[2, 2]
        offsets = np.array([*offsets[:2], in_force.offsets_mgauss[2]])
    return FieldCorrection.from_matrix(offsets, 0.5 * (matrix + matrix.T)).with_motor_of(in_force)


def heading_budget(
    problem: PositionProblem, fit: Fit, blend: tuple[FloatArray, FloatArray, FloatArray]
) -> dict[str, float]:
    """Split the heading's rms sigma over the circle by source, radians; the squares add up to the whole."""
    k, (state, covariance, shared) = len(problem.readings), blend
    circle = np.arange(36) * (2.0 * math.pi / 36)
    gradient = np.zeros((36, fit.state.size))
    gradient[:, :9] = heading_gradient(state, circle)
    gains = gradient @ fit.covariance @ fit.jacobian.T  # heading by whitened residual, (36, R)
    field = gains[:, : 3 * k].reshape(36, k, 3)
    variance = dict.fromkeys(_PARTS, 0.0)
    for name, part in problem.parts.items():
        unit = problem.whiten @ part @ np.swapaxes(problem.whiten, 1, 2)
        variance[name] = float(np.einsum("nki,kij,nkj->n", field, unit, field).mean())
    variance[ACCELEROMETER] = float(((gradient @ shared) ** 2).sum(axis=1).mean())
    rest = (gains[:, 3 * k :] ** 2).mean(axis=0)
    variance["step_angle"] = float(rest[: k - 1].sum())
    for place, share in zip(problem.rules.places, rest[k - 1 : -1], strict=True):
        source = GIVEN_HEADING if place >= HEADINGS else _SOURCE_OF.get(place, "prior")
        variance[source] = variance.get(source, 0.0) + float(share)
    variance["prior"] += float(rest[-1])
    # What the blends add (was a dwell disturbed? are there cross terms?) or save goes to the disturbance,
    # or lowers all alike.
    whole = float(np.einsum("ni,ij,nj->n", gradient, covariance, gradient).mean())
    sum_of_parts = max(sum(variance.values()), 1e-30)
    if whole >= sum_of_parts:
        variance["disturbance"] += whole - sum_of_parts
        sum_of_parts = whole
    return {name: math.sqrt(value * whole / sum_of_parts) for name, value in variance.items()}


# --- what it cannot determine, and the one further pose or turn that would help most ----------------


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
        loads=np.zeros((2, 1)),
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
