"""The four-position fit: measurements with their covariances, the prior, a first state, and its solution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.model import (
    GAIN,
    HEADINGS,
    HORIZONTAL,
    OFFSET,
    VERTICAL,
    by_tilt,
    gain_matrix,
    gain_parameters,
)
from mavcompass.calibration.observation import FourPositionData, Step
from mavcompass.calibration.rigid import (
    DEFAULT_PRIOR,
    IronPrior,
    PriorRows,
    Readings,
    assembled,
    common_error,
    covariance_of,
    prior_rows,
    settle,
)
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body
from mavcompass.heading.compute import level_field

# What no error model names: the sensor's own bends and steps of its converter.
_FLOOR_MGAUSS = 0.01
_ROBUST_FROM, _ROUNDS, _STEPS_A_ROUND = 6, 20, 2
_LEAST_CHANGE = 0.5  # of a reading by the field there: 29 degrees of turning
_MANY_SIGMAS_3D = 11.34  # chi-square of three, 99 %


@dataclass(frozen=True, slots=True, eq=False)
class PositionProblem:
    """Hold the measurements in the form the fit works on."""

    readings: Readings
    rules: PriorRows
    whiten: FloatArray  # (K, 3, 3), maps residuals to unit variance
    parts: Mapping[str, FloatArray]  # of the residuals' covariance, by source, (K, 3, 3) each
    leaning: FloatArray  # (K, 3, 2): one sigma of the accelerometer's error, common to all, in the field
    start: FloatArray  # (P,)
    mirrored: bool

    @classmethod
    def of(
        cls, data: FourPositionData, in_force: FieldCorrection, earth: EarthField | None, prior: IronPrior
    ) -> PositionProblem:
        """Prepare the fit: the start by linear least squares, the weights, the prior."""
        dwells = data.dwells
        if data.first_heading is None and len(dwells) < (fewest := prior.fewest_positions):
            raise PoorCalibration(
                f"Only {len(dwells)} still positions: offset and amplitude need at least {fewest}.",
                "Turn the vehicle in four steps of about 90 degrees and stop after each.",
            )
        mean = np.array([d.mean_mgauss for d in dwells])
        tilts = level_to_body([d.roll_rad for d in dwells], [d.pitch_rad for d in dwells])
        current = np.array([d.current_a for d in dwells])
        readings = Readings(
            middle_s=np.concatenate([[0.0], np.cumsum([s.duration_s for s in data.steps])]),
            mean_mgauss=mean,
            mapping=tilts @ np.array([d.swing for d in dwells]),
            by_lag=np.zeros((len(dwells), 3, 3)),
            load=current - current.mean() if np.isfinite(current).all() else np.zeros(len(dwells)),
            turned_rad=data.turned_rad,
            step_sigma_rad=np.array([max(s.sigma_rad, 1e-6) for s in data.steps]),
        )
        if data.first_heading is not None and earth is not None:
            headings = data.first_heading[0] + data.turned_rad
            start, mirrored = _start_at(headings, mean, tilts, np.array(earth.ned_mgauss), prior), False
        elif len(dwells) < DEFAULT_PRIOR.fewest_positions:
            start, mirrored = _start_by_two(mean, tilts, data.turned_rad, earth, in_force, prior), False
        else:
            start, mirrored = _start(mean, tilts, data.turned_rad, earth, in_force)
        rules = prior_rows(
            len(dwells),
            prior,
            earth,
            in_force,
            float(start[VERTICAL]),
            (data.gyro_scale_sigma, data.gyro_bias_sigma_radps),
            prior.motor_sigma_mgauss_per_a,
            data.first_heading,
        )
        noise = np.array([d.covariance_mgauss2 for d in dwells]) + _FLOOR_MGAUSS**2 * np.eye(3)
        quantisation = np.array([d.quantisation_mgauss2 for d in dwells])
        leaning = by_tilt(tilts, start, start[HEADINGS:])
        sigma2 = np.array([d.tilt_sigma_rad for d in dwells])[:, np.newaxis, np.newaxis] ** 2
        tilt = leaning @ np.swapaxes(leaning, 1, 2) * sigma2
        return cls(
            readings=readings,
            rules=rules,
            whiten=np.linalg.inv(np.linalg.cholesky(noise + quantisation + tilt)),
            parts={"noise": noise, "quantisation": quantisation, "tilt": tilt},
            leaning=leaning * data.tilt_bias_sigma_rad,
            start=start,
            mirrored=mirrored,
        )

    def loosened(self, index: int, size_mgauss: float) -> PositionProblem:
        """Let one dwell's field be off by an unknown amount of that size, each axis."""
        parts, whiten = {**self.parts, "noise": self.parts["noise"].copy()}, self.whiten.copy()
        parts["noise"][index] += size_mgauss**2 * np.eye(3)
        whiten[index] = np.linalg.inv(np.linalg.cholesky(sum(part[index] for part in parts.values())))
        return replace(self, parts=parts, whiten=whiten)

    def with_pose(
        self, state: FloatArray, turn_rad: float, roll_rad: float, pitch_rad: float, step: Step
    ) -> PositionProblem:
        """Add a pose not yet taken, as certain as the best so far, reading what `state` predicts."""
        tilt = level_to_body(roll_rad, pitch_rad)
        psi = float(state[-1]) + turn_rad
        level = level_field(psi, state[HORIZONTAL], state[VERTICAL])
        reading = state[OFFSET] + gain_matrix(state[GAIN]) @ tilt @ level
        best = int(np.argmin(np.trace(sum(self.parts.values()), axis1=1, axis2=2)))

        def grown(array: FloatArray, value: FloatArray) -> FloatArray:
            return np.concatenate([array, np.asarray(value)[np.newaxis]])

        return replace(
            self,
            readings=self.readings.with_one_more(
                reading, tilt, turn_rad, max(step.sigma_rad, 1e-6), step.duration_s
            ),
            rules=replace(self.rules, rows=np.pad(self.rules.rows, ((0, 0), (0, 1)))),
            start=grown(state, np.array(psi)),
            whiten=grown(self.whiten, self.whiten[best]),
            parts={name: grown(part, part[best]) for name, part in self.parts.items()},
            leaning=grown(self.leaning, self.leaning[best]),
        )


def _start_at(
    headings: FloatArray, mean: FloatArray, tilts: FloatArray, ned_mgauss: FloatArray, prior: IronPrior
) -> FloatArray:
    """Take the gains for the prior's: at known headings the offset is what the field there leaves."""
    state = np.zeros(HEADINGS + headings.size)
    state[GAIN], state[HEADINGS:] = prior.gains, headings
    state[HORIZONTAL], state[VERTICAL] = math.hypot(*ned_mgauss[:2]), ned_mgauss[2]
    body = np.einsum("kij,kj->ki", tilts, level_field(headings, state[HORIZONTAL], state[VERTICAL]))
    state[OFFSET] = (mean - body @ gain_matrix(state[GAIN])).mean(axis=0)
    return state


def _start_by_two(
    mean: FloatArray,
    tilts: FloatArray,
    turned: FloatArray,
    earth: EarthField | None,
    in_force: FieldCorrection,
    prior: IronPrior,
) -> FloatArray:
    """Read the first heading off what a turn changes, by the prior's gains.

    The level field being H exp(-i psi), two readings differ by H exp(-i psi_1) (1 - exp(-i turned)) (P0).
    """
    level = np.einsum("kji,kj->ki", tilts, mean @ np.linalg.inv(gain_matrix(prior.gains)).T)
    change = 1.0 - np.exp(-1j * (turned[-1] - turned[0]))
    if abs(change) < _LEAST_CHANGE:
        raise _too_little_turning(turned)
    first = complex(level[0, 0] - level[-1, 0], level[0, 1] - level[-1, 1]) / change
    vertical = _vertical(mean, earth, in_force)
    horizontal = earth.horizontal_mgauss if earth is not None else abs(first)
    headings = turned - turned[0] - float(np.angle(first))
    return _start_at(headings, mean, tilts, np.array([horizontal, 0.0, vertical]), prior)


def _vertical(mean: FloatArray, earth: EarthField | None, in_force: FieldCorrection) -> float:
    return float(earth.ned_mgauss[2] if earth is not None else in_force.apply(mean).mean(axis=0)[2])


def _too_little_turning(turned: FloatArray) -> PoorCalibration:
    degrees = math.degrees(float(np.ptp(turned)))
    return PoorCalibration(
        f"The positions cover too little of the circle: {degrees:.0f} degrees of turning in all.",
        "Turn the vehicle in four steps of about 90 degrees and stop after each.",
    )


def _start(
    mean: FloatArray,
    tilts: FloatArray,
    turned: FloatArray,
    earth: EarthField | None,
    in_force: FieldCorrection,
) -> tuple[FloatArray, bool]:
    """Fit r = c + p cos(turned) + q sin(turned) per axis and read a first state off it.

    With psi = psi_1 + turned the horizontal part is H T F(psi_1), F a reflection; a positive
    determinant of (p, q) means that the field turns the wrong way.
    """
    design = np.stack([np.ones(turned.size), np.cos(turned), np.sin(turned)], axis=1)
    singular = np.linalg.svd(design, compute_uv=False)
    if singular[-1] < 0.12 * math.sqrt(turned.size):
        raise _too_little_turning(turned)
    line, *_ = np.linalg.lstsq(design, mean, rcond=None)
    plane = line[1:, :2].T
    amplitude = float(np.sqrt(abs(np.linalg.det(plane))))
    if amplitude < 1.0:
        raise PoorCalibration(
            f"The field hardly changes while the vehicle turns (amplitude {amplitude:.1f} mG): this compass "
            "is dead, frozen or reads only its offsets.",
            "Check the compass's wiring and that COMPASS_USE and the driver see the sensor.",
        )
    mirrored = float(np.linalg.det(plane)) > 0.0
    horizontal = earth.horizontal_mgauss if earth is not None else amplitude
    vertical = _vertical(mean, earth, in_force)
    if mirrored:
        plane = plane * np.array([[1.0], [-1.0]])
    left, values, right = np.linalg.svd(plane / horizontal)
    gain = left @ np.diag(values) @ left.T
    reflection = left @ right
    state = np.zeros(HEADINGS + turned.size)
    state[GAIN] = gain_parameters(np.block([[gain, np.zeros((2, 1))], [np.zeros((1, 2)), np.eye(1)]]))
    state[GAIN][2] = 0.5 * (gain[0, 0] + gain[1, 1])
    state[HORIZONTAL], state[VERTICAL] = horizontal, vertical
    first = math.atan2(-reflection[1, 0], reflection[0, 0])
    state[HEADINGS:] = first + turned
    state[OFFSET] = line[0] - gain_matrix(state[GAIN]) @ tilts.mean(axis=0) @ [0.0, 0.0, vertical]
    return state, mirrored


@dataclass(frozen=True, slots=True, eq=False)
class PositionFit:
    state: FloatArray
    covariance: FloatArray
    residual: FloatArray  # (K, 3), mG
    jacobian: FloatArray  # whitened, rows: 3K field, K-1 steps, prior
    weights: FloatArray  # (K,)
    cost: float  # the squared whitened residuals, prior included
    chi_square: float
    freedom: int


def fit_positions(problem: PositionProblem, near: PositionFit | None = None) -> PositionFit:
    """Fit the positions; dwells far out weigh less where there are many.

    The fit of a problem that is nearly the same may be given to begin with.
    """
    readings = problem.readings
    x, weights = (problem.start, np.ones(len(readings))) if near is None else (near.state, near.weights)
    if len(readings) >= _ROBUST_FROM:
        for _ in range(_ROUNDS):
            x = settle(readings, x, _roots(problem, weights), problem.rules, _STEPS_A_ROUND)
            before, weights = weights, _weights(problem, readings.field(x)[0])
            if float(np.abs(weights - before).max()) < 1e-3:
                break
    roots = _roots(problem, weights)
    x = settle(readings, x, roots, problem.rules)
    residual, _ = readings.field(x)
    values, jacobian = assembled(readings, x, roots, problem.rules)
    covariance = covariance_of(jacobian)
    # What the fit cannot absorb of each measurement adds up to the degrees of freedom.
    measured = 4 * len(readings) - 1
    rows = jacobian[:measured]
    absorbed = float(((rows @ covariance) * rows).sum())
    return PositionFit(
        state=x,
        covariance=covariance,
        residual=residual,
        jacobian=jacobian,
        weights=weights,
        cost=float(values @ values),
        chi_square=float(values[:measured] @ values[:measured]),
        freedom=max(round(measured - absorbed), 0),
    )


def leaning_error(problem: PositionProblem, fit: PositionFit) -> FloatArray:
    """Return what the accelerometer's own error, the same in every dwell, adds to the state, (P, 2).

    By roll and by pitch, one sigma each: on the level it looks like an offset.
    """
    leaning = problem.whiten @ problem.leaning * np.sqrt(fit.weights)[:, np.newaxis, np.newaxis]
    return common_error(leaning, fit.covariance, fit.jacobian)


def _roots(problem: PositionProblem, weights: FloatArray) -> FloatArray:
    return np.asarray(problem.whiten * np.sqrt(weights)[:, np.newaxis, np.newaxis])


def _weights(problem: PositionProblem, field: FloatArray) -> FloatArray:
    distance = (np.einsum("kij,kj->ki", problem.whiten, field) ** 2).sum(axis=1)
    return np.asarray(np.minimum(1.0, _MANY_SIGMAS_3D / np.maximum(distance, 1e-12)))
