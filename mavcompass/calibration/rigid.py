"""A rigid compass at K headings that the gyro ties together: one least-squares problem for every motion.

Still positions (`positions`) and sections of any motion (`motion`) read (M1) and are told apart only by how
their covariances are known. The state has the numbers of `model.NAMES`, then the K headings, then those of
further loads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.model import (
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADINGS,
    HORIZONTAL,
    LAG,
    OFFSET,
    VERTICAL,
    gain_jacobian,
    gain_matrix,
    gain_parameters,
    motor_places,
)
from mavcompass.chance import chance_of_more
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.frames import FloatArray
from mavcompass.heading.compute import level_field

# What is not known of how far the field lags behind the gyro.
_LAG_SIGMA_S = 0.03
# Gains times the Earth's field are all that shows: where no world model tells it, the horizontal gains'
# mean is one by convention.
_SCALE_SIGMA = 0.01
_STEPS = 40
# Of the scaled normal equations; more where a step does not lower the cost.
_DAMPING, _FIRST_DAMPING, _MOST_DAMPING = 1e-12, 1e-3, 1e3
# A step that lowers the cost by this share of one residual's settles nothing more.
_SETTLED = 1e-3
# Limits are taken for two sigmas. Gains that nobody has measured: MAGFit keeps diagonals within 0.8 to 1.2.
_GAIN_SIGMA = 0.1
# Gains in force: ArduPilot keeps a calibration that leaves 16 mG rms at most of a field of some 500 mG.
_IN_FORCE_SIGMA = 0.016
_AXES = np.eye(3)


@dataclass(frozen=True, slots=True)
class IronPrior:
    """State what is known of a compass before the vehicle turns.

    Attributes:
        gain_sigma: of each horizontal gain.
        vertical_gain_sigma: of the vertical gain about the mean of the horizontal ones.
        cross_sigma: of the cross terms, where there are any. own_cross_sigma: of a sensor's own without iron:
            axes are square, and set to the vehicle's, within a third of a degree.
        site_sigma_mgauss: what rocks, buildings and parked cars add to the world model, each component.
        motor_sigma_mgauss_per_a: of the field of the battery current, each axis.
        vertical_offset_sigma_mgauss: of the offset in force on Z, where there is no world model.
        gains: what all these sigmas are about, as `model.gain_parameters` has them.
    """

    gain_sigma: float = 0.25
    vertical_gain_sigma: float = 0.05
    cross_sigma: float = 0.04
    own_cross_sigma: float = 0.005
    site_sigma_mgauss: float = 5.0
    motor_sigma_mgauss_per_a: float = 0.5
    vertical_offset_sigma_mgauss: float = 100.0
    gains: tuple[float, ...] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)

    @property
    def fewest_positions(self) -> int:
        """Return how many positions tell offset and field: two where the gains are known before."""
        return 2 if self.gain_sigma <= _GAIN_SIGMA else 3

    def of(self, in_force: FieldCorrection) -> IronPrior:
        """Take the gains that a calibration in force has, if it has any, for better known than others."""
        gains = gain_parameters(in_force.inverse)
        if not any(in_force.offsets_mgauss) or np.allclose(gains, self.gains, atol=1e-6):
            return replace(self, gain_sigma=_GAIN_SIGMA)
        known = dict.fromkeys(("gain_sigma", "cross_sigma", "own_cross_sigma"), _IN_FORCE_SIGMA)
        return replace(self, gains=tuple(gains), **known)


DEFAULT_PRIOR = IronPrior()


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Hold K mean readings of a compass and the K - 1 turns between them.

    Attributes:
        middle_s: when they were taken, in the middle, (K,).
        mean_mgauss: raw field, (K, 3). mapping: A of (M1), level axes to body axes, (K, 3, 3); by_lag: its
            change per second of the field's lag. loads: of the motors, (K, L), less their means.
        turned_rad: the gyro's angle then, (K,), clockwise. step_sigma_rad: of the K - 1 turns between,
            without the gyro's scale and bias.
    """

    middle_s: FloatArray
    mean_mgauss: FloatArray
    mapping: FloatArray
    by_lag: FloatArray
    loads: FloatArray
    turned_rad: FloatArray
    step_sigma_rad: FloatArray

    def __len__(self) -> int:
        """Count the readings."""
        return len(self.mean_mgauss)

    @property
    def motor(self) -> NDArray[np.intp]:
        """Return the places of the loads' fields in the state, (3 L,)."""
        return motor_places(*self.loads.shape)

    def linear(self, x: FloatArray, headings_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (..., K, 3) at headings (..., K), whatever those of the state.

        And the derivative of the prediction by the linear part, offset, gain, motors: (..., K, 3, 9 + 3 L).
        """
        gain, mapping = gain_matrix(x[GAIN]), self.mapping + x[LAG] * self.by_lag
        return self._linear(x, gain, mapping, level_field(headings_rad, x[HORIZONTAL], x[VERTICAL]))

    def _linear(
        self, x: FloatArray, gain: FloatArray, mapping: FloatArray, level: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        body, motor = np.einsum("kij,...kj->...ki", mapping, level), self.motor
        by = np.empty((*body.shape, 9 + motor.size))
        by[..., :3], by[..., 3:9] = _AXES, gain_jacobian(body)
        by[..., 9:] = np.kron(self.loads[:, np.newaxis], _AXES)
        return self.mean_mgauss - (x[OFFSET] + body @ gain + self.loads @ x[motor].reshape(-1, 3)), by

    def field(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (K, 3) and the derivative of the prediction by the state, (K, 3, P)."""
        k = len(self)
        psi, h = x[HEADINGS : HEADINGS + k], x[HORIZONTAL]
        gain, mapping = gain_matrix(x[GAIN]), self.mapping + x[LAG] * self.by_lag
        level = level_field(psi, h, x[VERTICAL])
        residual, linear = self._linear(x, gain, mapping, level)
        by = np.zeros((k, 3, x.size))
        by[:, :, : GAIN.stop], by[:, :, self.motor] = linear[:, :, : GAIN.stop], linear[:, :, GAIN.stop :]
        cos, sin, seen = np.cos(psi), np.sin(psi), gain @ mapping
        by[:, :, HORIZONTAL] = seen[:, :, 0] * cos[:, np.newaxis] - seen[:, :, 1] * sin[:, np.newaxis]
        by[:, :, VERTICAL] = seen[:, :, 2]
        by[:, :, LAG] = np.einsum("kij,kj->ki", self.by_lag, level) @ gain
        across = -h * (seen[:, :, 0] * sin[:, np.newaxis] + seen[:, :, 1] * cos[:, np.newaxis])
        by[np.arange(k), :, HEADINGS + np.arange(k)] = across
        return residual, by

    def turns(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the whitened residuals of the turns, (K - 1,), and their derivative by the state."""
        turn = np.diff(x[HEADINGS : HEADINGS + len(self)])
        lasted_s, sigma = np.diff(self.middle_s), self.step_sigma_rad
        scale = 1.0 + x[GYRO_SCALE]
        rows = np.arange(len(turn))
        jacobian = np.zeros((len(turn), x.size))
        jacobian[rows, HEADINGS + rows + 1] = scale / sigma
        jacobian[rows, HEADINGS + rows] = -scale / sigma
        jacobian[:, GYRO_SCALE] = turn / sigma
        jacobian[:, GYRO_BIAS] = lasted_s / sigma
        return (scale * turn + x[GYRO_BIAS] * lasted_s - np.diff(self.turned_rad)) / sigma, jacobian


class PriorRows(NamedTuple):
    """Hold what is known beforehand, whitened: rows (Q, P) times the state are `wanted` (Q,), each within 1.

    places: of the state's number that a row holds, (Q - 1,); the last holds the vertical gain by the others.
    """

    rows: FloatArray
    wanted: FloatArray
    places: tuple[int, ...]

    def of(self, x: FloatArray) -> FloatArray:
        """Return the whitened residuals of a state, (Q,)."""
        return np.asarray(self.rows @ x - self.wanted)


def prior_rows(
    shape: tuple[int, ...],
    prior: IronPrior,
    earth: EarthField | None,
    in_force: FieldCorrection,
    vertical_mgauss: float,
    gyro_sigma: tuple[float, float],
    motor_sigma: float,
    first_heading: tuple[float, float] | None = None,
) -> PriorRows:
    """Write the prior of readings with loads of a shape (K, L) as whitened rows.

    Args:
        vertical_mgauss: the vertical field, as far as `earth` does not tell it.
        gyro_sigma: of its scale, and of its bias in rad/s.
        motor_sigma: of the motors' field per unit of load.
        in_force: gives Z's offset where no world model does.
        first_heading: magnetic, of the first reading, and its sigma, where that is known.
    """
    scale_sigma, bias_sigma = (max(sigma, 1e-9) for sigma in gyro_sigma)
    # A number of the state, or several by their mean.
    held: list[tuple[int | list[int], float, float]] = [
        *((i, prior.gains[i - 3], prior.gain_sigma) for i in (3, 4)),
        *((i, prior.gains[i - 3], prior.cross_sigma) for i in (6, 7, 8)),
        (GYRO_SCALE, 0.0, scale_sigma),
        (GYRO_BIAS, 0.0, bias_sigma),
        *((i, 0.0, motor_sigma) for i in motor_places(*shape).tolist()),
        (LAG, 0.0, _LAG_SIGMA_S),
    ]
    if earth is not None:
        north, east, down = earth.sigma_mgauss
        turned = earth.declination_rad
        along = math.hypot(north * math.cos(turned), east * math.sin(turned))
        held.append((HORIZONTAL, earth.horizontal_mgauss, math.hypot(along, prior.site_sigma_mgauss)))
        held.append((VERTICAL, float(earth.ned_mgauss[2]), math.hypot(down, prior.site_sigma_mgauss)))
    else:
        held.append(([3, 4], 1.0, _SCALE_SIGMA))
        held.append((VERTICAL, vertical_mgauss, max(0.5 * abs(vertical_mgauss), 50.0)))
        held.append((2, -in_force.offsets_mgauss[2], prior.vertical_offset_sigma_mgauss))
    if first_heading is not None:
        held.append((HEADINGS, *first_heading))
    readings, loads = shape
    rows, wanted = np.zeros((len(held) + 1, HEADINGS + readings + 3 * (loads - 1))), np.zeros(len(held) + 1)
    for row, (place, value, sigma) in enumerate(held):
        rows[row, place], wanted[row] = 1.0 / np.size(place) / sigma, value / sigma
    rows[-1, 3:6] = np.array([-0.5, -0.5, 1.0]) / prior.vertical_gain_sigma
    wanted[-1] = rows[-1, 3:6] @ prior.gains[:3]
    return PriorRows(rows, wanted, tuple(int(np.max(place)) for place, _, _ in held))


def assembled(
    readings: Readings, x: FloatArray, roots: FloatArray, rules: PriorRows
) -> tuple[FloatArray, FloatArray]:
    """Return the whitened residuals, (R,), and their Jacobian, (R, P): field (3 K), turns (K - 1), prior.

    `roots` (K, 3, 3) whiten the field's residuals.
    """
    residual, by = readings.field(x)
    turns, by_turns = readings.turns(x)
    rows = -(roots @ by).reshape(-1, x.size)
    values = np.einsum("kij,kj->ki", roots, residual).ravel()
    return np.concatenate([values, turns, rules.of(x)]), np.concatenate([rows, by_turns, rules.rows])


def settle(
    readings: Readings, x: FloatArray, roots: FloatArray, rules: PriorRows, steps: int = _STEPS
) -> FloatArray:
    """Minimise by Levenberg and Marquardt's steps, from a state near enough.

    Where the weights depend on the state, few `steps` at a time save settling what will be weighed anew.
    """
    values, jacobian = assembled(readings, x, roots, rules)
    damping, diagonal = _DAMPING, np.diag_indices(x.size)
    for _ in range(steps):
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
        scaled = jacobian * scale
        normal, downhill = scaled.T @ scaled, -scaled.T @ values
        # Not worse than by the last digits of a minimum, which are noise.
        cost = float(values @ values)
        while True:
            damped = normal.copy()
            damped[diagonal] += damping
            step = np.linalg.solve(damped, downhill)
            trial = x + scale * step
            values, jacobian = assembled(readings, trial, roots, rules)
            if float(values @ values) <= cost * (1.0 + 1e-9) or damping > _MOST_DAMPING:
                break
            damping = max(10.0 * damping, _FIRST_DAMPING)
        x, damping = trial, max(0.1 * damping, _DAMPING)
        if (cost - float(values @ values)) * len(values) <= _SETTLED * cost:
            break
    return x


def covariance_of(jacobian: FloatArray) -> FloatArray:
    """Return the covariance of the state, (P, P), by the whitened Jacobian (R, P)."""
    scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    scaled = jacobian * scale
    inverse = np.linalg.inv(scaled.T @ scaled + _DAMPING * np.eye(len(scale)))
    return np.asarray(inverse * np.outer(scale, scale))


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Hold the solution of a problem of K readings.

    Attributes:
        state, covariance: the numbers named by `model.NAMES`, K headings, further loads: (P,), (P, P).
        residual_mgauss: measured less predicted, (K, 3).
        sound: how far each reading is believed, 0 to 1, (K,). roots: what whitens its residual, (K, 3, 3).
        whitened, jacobian: the residuals of field (3 K), turns (K - 1) and prior, and their derivative by the
            state: (R,), (R, P).
    """

    state: FloatArray
    covariance: FloatArray
    residual_mgauss: FloatArray
    sound: FloatArray
    roots: FloatArray
    whitened: FloatArray
    jacobian: FloatArray

    @classmethod
    def of(
        cls, readings: Readings, x: FloatArray, roots: FloatArray, rules: PriorRows, sound: FloatArray
    ) -> Self:
        """Settle a state near enough, and say what is known of it."""
        x = settle(readings, x, roots, rules)
        values, jacobian = assembled(readings, x, roots, rules)
        covariance = covariance_of(jacobian)
        return cls(x, covariance, readings.field(x)[0], sound, roots, values, jacobian)

    @property
    def offset_mgauss(self) -> FloatArray:
        """Return the hard iron, (3,)."""
        return self.state[OFFSET]

    @property
    def gain(self) -> FloatArray:
        """Return the symmetric gain, (3, 3)."""
        return gain_matrix(self.state[GAIN])

    @property
    def headings_rad(self) -> FloatArray:
        """Return the readings' magnetic headings, (K,)."""
        return self.state[HEADINGS : HEADINGS + len(self.sound)]

    @property
    def motor(self) -> NDArray[np.intp]:
        """Return the places of the loads' fields in the state, (3 L,)."""
        readings = len(self.sound)
        return motor_places(readings, 1 + (self.state.size - HEADINGS - readings) // 3)

    @property
    def motors_mgauss(self) -> FloatArray:
        """Return the field per unit of each load, (L, 3)."""
        return self.state[self.motor].reshape(-1, 3)

    @property
    def cost(self) -> float:
        """Return half the squared whitened residuals, prior included; lower is likelier."""
        return 0.5 * float(self.whitened @ self.whitened)

    @property
    def chi_square(self) -> float:
        """Return the squared whitened residuals of what was measured."""
        measured = self.whitened[: 4 * len(self.sound) - 1]
        return float(measured @ measured)

    @property
    def freedom(self) -> int:
        """Return how many of the measured numbers the fit cannot absorb."""
        rows = self.jacobian[: 4 * len(self.sound) - 1]
        return max(round(len(rows) - float(((rows @ self.covariance) * rows).sum())), 0)

    @property
    def chance(self) -> float:
        """Return the probability that chance leaves more of what was measured."""
        return chance_of_more(self.chi_square, self.freedom)

    def common_error(self, by: FloatArray) -> FloatArray:
        """Return what errors common to all readings, one sigma each, (K, 3, M), add to the state, (P, M).

        No agreement between the readings shows them, no further one averages them out.
        """
        rows = (self.roots @ by).reshape(-1, by.shape[2])
        return np.asarray(self.covariance @ self.jacobian[: len(rows)].T @ rows)
