"""The equations of an error-state smoother about any trajectory.

A trajectory R(t), integrated from the gyro, is off by a small rotation phi in world axes,
R_true = exp(phi) R. Between two knots (Farrell, Aided Navigation, chapter 11; Groves, Principles of GNSS and
Inertial Navigation, section 14.2):

    phi'  = -R (b + diag(w) s)             gyro: bias b, which walks, and scale s
    v'    = R (f - a) + g + phi x R f      accelerometer: bias a, velocity v
    v_receiver = v - late v'               a receiver's velocity is late
    yaw witness = phi_z + c + e_fast + e_slow + a_1 e_1 + a_2 e_2 ...   its turns (`remembered_turns`)

What turns forces into velocities is the yaw, too: where a vehicle accelerates, its receiver tells the yaw
without any compass. Without a receiver the velocity stays within bounds. The whole is linear and normal, is
solved in one piece, and about the corrected trajectory again until nothing moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, matrix_to_rotvec, rotvec_to_matrix
from mavcompass.gap.attitude.chain import Chain, Solved, knots_of, silences
from mavcompass.gap.attitude.kinematics import carried, cross_matrices, integral, integrated, interpolated
from mavcompass.gap.attitude.sensors import MEDIAN_OF_SQUARES, Bias, Velocity, white_floor
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.sampling import first_order_lag
from mavcompass.units import STANDARD_GRAVITY_MPS2

_GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
# States: rotation, gyro bias, velocity; what a witness is off by: yaw for seconds and for minutes, level.
PHI, BIAS, _V, _FAST, _SLOW, _LEVEL, _STATES = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, (11, 12), 13
# Constants: gyro scale, accelerometer bias, the receiver's delay, the witness's constant and its turns.
SCALE, ACC, _LATE, _OFFSET, _TURNS, _CONSTANTS = slice(0, 3), slice(3, 6), 6, 7, slice(8, 11), 11
# How long a filter remembers what a turn has made of its yaw: one of these about, none tells.
_TURN_MEMORIES_S = np.array([2.0, 8.0, 32.0])


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """Hold an attitude (N, 3, 3) that tells of the yaw, at the gyro's times, or only of the level.

    `constant_rad` is the standard deviation of its constant error, `slow_rad` of what wanders for minutes; it
    tells nothing of the yaw where `constant_rad` is infinite.
    """

    rotation: FloatArray
    constant_rad: float
    slow_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """Hold what the vehicle's own sensors say.

    Times (N,), rates and forces in body axes (N, 3), and where a force was felt, (N,).
    """

    time_s: FloatArray
    rate_radps: FloatArray
    force_mps2: FloatArray
    felt: NDArray[np.bool_]


class Smoother:
    """Build the chain of one recording about any trajectory."""

    def __init__(
        self,
        sensed: Sensed,
        bias: Bias,
        velocity: Velocity | None,
        witness: Witness | None,
        scale_sigma: float,
    ) -> None:
        clock = sensed.time_s
        self.clock, self.knots = clock, knots_of(clock)
        self.step = np.diff(self.knots)
        self._is_silent = np.isin(self.knots[:-1], clock[:-1][silences(clock)])
        self.news_s = float(np.median(self.step))
        self.rate, self.force = sensed.rate_radps - bias.mean, sensed.force_mps2
        self.bias, self.witness, self._scale_sigma = bias, witness, scale_sigma
        self.seen = None if velocity is None else velocity.at(self.knots)
        self._still = integrated(clock, self.rate)
        self._still_knots = self.at_knots(self._still)
        self._turned = self._still_knots[:-1].transpose(0, 2, 1) @ self._still_knots[1:]
        self._walk, self._unturned = self._walked(self.rate, usual.gyro.walk_rad, 0.5)
        self._push, self._unpushed = self._walked(self.force, usual.accelerometer.walk_mps, 0.7)
        self._told = None if witness is None else self.at_knots(witness.rotation)
        self._linked = self._turned
        if self._told is not None:
            # How far it turned while nothing was heard, an autopilot knows, whichever compass steers it.
            known = self._is_silent & (self._unturned > usual.autopilot.turn_rad**2)
            turn = self._told[:-1].transpose(0, 2, 1) @ self._told[1:]
            bent = usual.autopilot.turn_share * np.linalg.norm(matrix_to_rotvec(turn), axis=1)
            self._linked = np.where(known[:, None, None], turn, self._turned)
            self._unturned = np.where(known, usual.autopilot.turn_rad**2 + bent**2, self._unturned)

    def chain(self, rotation: FloatArray, trust: FloatArray) -> Chain:
        """Return all equations about a trajectory (N, 3, 3) but those whose size is still to be found."""
        chain = Chain(self.knots.size, _STATES, _CONSTANTS)
        at, turn, gain = self.at_knots(rotation), *self._integrals(rotation)
        force = np.einsum("nij,nj->ni", rotation, self.force)
        pushed = self._between_knots(force)
        count = len(turn)
        # Scatter of body axes in those of the world, along each of them.
        seen_by, time = at[:-1] ** 2, self.step[:, None]
        angle = time * (seen_by @ self._walk) + self._unturned[:, None]
        push = time * (seen_by @ self._push) + self._unpushed[:, None]
        one, unit = np.ones((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        before, after, c = _blank(count, 3), _blank(count, 3), np.zeros((count, 3, _CONSTANTS))
        # phi_1 - phi_0 + integral R b + integral R diag(w) s = what the gyro turns beyond the trajectory
        before[:, :, PHI], after[:, :, PHI], before[:, :, BIAS], c[:, :, SCALE] = -unit, unit, turn, gain
        beyond = matrix_to_rotvec(at[:-1] @ self._linked @ at[1:].transpose(0, 2, 1))
        chain.link(before, after, c, beyond, 1.0 / angle)
        before, after = _blank(count, 3), _blank(count, 3)
        before[:, :, BIAS], after[:, :, BIAS] = -unit, unit
        chain.link(before, after, None, 0.0 * one, one / (usual.gyro.bias_walk_radps**2 * self.step[:, None]))
        # v_1 - v_0 + [integral R f]x phi + integral R a = integral (R f + g)
        before, after, c = _blank(count, 3), _blank(count, 3), np.zeros((count, 3, _CONSTANTS))
        leaning = 0.5 * cross_matrices(pushed)
        before[:, :, _V], after[:, :, _V], c[:, :, ACC] = -unit, unit, turn
        before[:, :, PHI] = after[:, :, PHI] = leaning
        chain.link(before, after, c, pushed + time * _GRAVITY, 1.0 / push)
        self._add_first(chain)
        slow = usual.autopilot.scatter_rad if self.witness is None else self.witness.slow_rad
        self._add_lasting(chain, _SLOW, slow, usual.autopilot.slow_s)
        for state in _LEVEL:
            self._add_lasting(chain, state, usual.autopilot.level_rad, usual.autopilot.level_s)
        self._add_lasting(
            chain, _FAST, usual.autopilot.fast_rad, usual.autopilot.fast_s, usual.autopilot.begins_rad
        )
        if self.seen is not None:
            self._add_velocity(chain, self.seen, trust)
        if self._told is not None and self.witness is not None:
            turned = np.concatenate([[0.0], np.cumsum(gain[:, 2].sum(axis=1))])
            self._add_witness(chain, at, self._told, self.witness, turned)
        return chain

    def bounded(self, chain: Chain, velocity_mps: float) -> Chain:
        """Return a chain whose velocity, where nobody tells it, stays within a bound."""
        if self.seen is not None:
            return chain
        chain = chain.copy()
        news = min(1.0, self.news_s / usual.velocity.memory_s)
        J = _blank(self.knots.size, 3)
        J[:, :, _V] = np.eye(3)
        none = np.zeros((self.knots.size, 3))
        chain.add(slice(None), J, None, none, none + velocity_mps**-2.0, news)
        return chain

    def likeliest_bound(self, chain: Chain) -> float:
        """Choose the bound of an unseen velocity that the recording makes likeliest, m/s."""
        if self.seen is not None:
            return float(usual.velocity.usual_mps)
        tried: tuple[float, ...] = usual.velocity.tried_mps
        return min(tried, key=lambda v: self.bounded(chain, v).solve().deviance)

    def full_trust(self) -> FloatArray:
        """Return the weights of a receiver's velocities (K, 3) before anything is known of them."""
        return np.ones((0 if self.seen is None else self.knots.size, 3))

    def trust(self, solved: Solved) -> FloatArray:
        """Return how far each of a receiver's velocities is believed, (K, 3): jumps have little weight."""
        if self.seen is None:
            return self.full_trust()
        off = np.abs(self._left(solved))
        return np.asarray(1.0 / np.maximum(1.0, off / usual.receiver.outlier))

    def excess(self, solved: Solved) -> float:
        """Return how much larger a receiver's errors are than stated, as a variance, at least 1."""
        if self.seen is None:
            return 1.0
        return max(1.0, float(np.median(self._left(solved) ** 2)) / MEDIAN_OF_SQUARES)

    def bears_out(self, solved: Solved) -> bool:
        """Tell whether a receiver's level velocity leaves less than it varies by, or twice its errors."""
        if self.seen is None:
            return True
        left = np.abs(self._left(solved)[:, :2])
        varies = self.seen.mean_mps[:, :2] - self.seen.mean_mps[:, :2].mean(axis=0)
        least = np.maximum(
            np.median(np.abs(varies), axis=0), usual.receiver.borne_out * self.seen.sigma_mps[:2]
        )
        return bool((np.median(left * self.seen.sigma_mps[:2], axis=0) < least).all())

    def through(self, rotation: FloatArray) -> FloatArray:
        """Carry rotations of the knots (K, 3, 3) to the gyro's times: between, it turns as the gyro says."""
        missed = matrix_to_rotvec(rotation[1:] @ (rotation[:-1] @ self._turned).transpose(0, 2, 1))
        left = np.clip(np.searchsorted(self.knots, self.clock, side="right") - 1, 0, self.step.size - 1)
        share = (self.clock - self.knots[left]) / self.step[left]
        since = (rotation[:-1] @ self._still_knots[:-1].transpose(0, 2, 1))[left] @ self._still
        return np.asarray(rotvec_to_matrix(missed[left] * share[:, None]) @ since)

    def telling(self) -> NDArray[np.int64]:
        """Return knots (M,) that tell how the error goes: even ones, and the ends of the longest silences."""
        even = np.linspace(0, self.knots.size - 1, usual.knots.telling).round().astype(np.int64)
        silent = np.flatnonzero(self._is_silent)
        longest = silent[np.argsort(-self.step[silent])][: usual.knots.silences]
        return np.unique(np.concatenate([even, longest, longest + 1]))

    def between(self, values: FloatArray) -> FloatArray:
        """Interpolate values of the knots (K, n) to the gyro's times."""
        return interpolated(self.knots, values, self.clock)

    def _left(self, solved: Solved) -> FloatArray:
        assert self.seen is not None
        late = solved.constants[_LATE] * self.seen.change_mps2
        return np.asarray((self.seen.mean_mps + late - solved.states[:, _V]) / self.seen.sigma_mps)

    def _add_first(self, chain: Chain) -> None:
        sigma = np.repeat([usual.yaw.lost_rad, 0.0, usual.receiver.unknown_mps], 3)
        sigma[BIAS] = self.bias.sigma
        none = np.zeros((1, sigma.size))
        chain.add(slice(1), np.eye(_STATES)[None, : sigma.size], None, none, none + sigma**-2.0)
        offset = usual.yaw.lost_rad if self.witness is None else self.witness.constant_rad
        known = np.repeat(
            [self._scale_sigma, usual.accelerometer.bias_mps2, usual.receiver.late_s, 0.0], [3, 3, 1, 4]
        )
        known[_OFFSET] = min(offset, usual.yaw.lost_rad)
        known[_TURNS] = np.hypot(self._scale_sigma, usual.autopilot.late_s / _TURN_MEMORIES_S)
        chain.know(np.zeros(_CONSTANTS), known)

    def _add_velocity(self, chain: Chain, seen: Velocity, trust: FloatArray) -> None:
        J, c = _blank(self.knots.size, 3), np.zeros((self.knots.size, 3, _CONSTANTS))
        J[:, :, _V], c[:, :, _LATE] = np.eye(3), -seen.change_mps2
        weight = min(1.0, self.news_s / usual.receiver.memory_s) / np.square(seen.sigma_mps)
        chain.add(slice(None), J, c, seen.mean_mps, weight * trust)

    def _add_witness(
        self, chain: Chain, at: FloatArray, told: FloatArray, witness: Witness, turned_rad: FloatArray
    ) -> None:
        apart = matrix_to_rotvec(told @ at.transpose(0, 2, 1))
        # Of the level alone, whatever the yaw: down there less down here, in world axes.
        down = np.cross(at[:, 2], told[:, 2])
        apart[:, :2] = -np.einsum("kij,kj->ki", at, down)[:, :2]
        J, c = _blank(self.knots.size, 3), np.zeros((self.knots.size, 3, _CONSTANTS))
        J[:, :, PHI] = np.eye(3)
        turning = interpolated(self.clock, self.rate, self.knots)
        late = usual.autopilot.late_s * np.linalg.norm(turning, axis=1)
        scatter = np.repeat([usual.autopilot.level_scatter_rad, usual.autopilot.scatter_rad], [2, 1])
        scatter = np.hypot(scatter, late[:, None])
        weights = min(1.0, self.news_s / usual.knots.apart_s) / scatter**2
        J[:, 0, _LEVEL[0]] = J[:, 1, _LEVEL[1]] = 1.0
        if math.isfinite(witness.constant_rad):
            J[:, 2, _FAST] = J[:, 2, _SLOW] = c[:, 2, _OFFSET] = 1.0
            c[:, 2, _TURNS] = remembered_turns(self.knots, turned_rad)
        else:
            weights[:, 2] = 0.0
        chain.add(slice(None), J, c, apart, weights)

    def _add_lasting(
        self, chain: Chain, state: int, size_rad: float, memory_s: float, first_rad: float = 0.0
    ) -> None:
        """Add a first-order process: an error that lasts for a while, and may begin larger than it stays."""
        keep = np.exp(-self.step / memory_s)
        chain.lasting(state, keep, 1.0 / (size_rad**2 * (1.0 - keep**2)), max(size_rad, first_rad) ** -2.0)

    def at_knots(self, rotation: FloatArray) -> FloatArray:
        """Carry rotations (N, 3, 3) to the knots with the rate at the nearest sample before."""
        return carried(self.clock, rotation, self.rate, self.knots)

    def _integrals(self, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the integrals of R and of R diag(w) between the knots, (K - 1, 3, 3) each."""
        both = np.concatenate([rotation, rotation * self.rate[:, None, :]], axis=2).reshape(-1, 18)
        integral = self._between_knots(both).reshape(-1, 3, 6)
        return integral[:, :, :3], integral[:, :, 3:]

    def _between_knots(self, values: FloatArray) -> FloatArray:
        """Integrate values (N, n) between the knots, (K - 1, n)."""
        return np.diff(interpolated(self.clock, integral(self.clock, values), self.knots), axis=0)

    def _walked(self, values: FloatArray, walk: float, share: float) -> tuple[FloatArray, FloatArray]:
        """Return the variances of integrals: of scatter and a walk, per second, (3,), and of each silence
        between knots, (K - 1,)."""
        each_s = float(np.median(np.diff(self.clock)))
        size = share * float(np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))
        silent = np.where(self._is_silent, (size * self.step) ** 2, 0.0)
        return white_floor(values) ** 2 * each_s + walk**2, silent


def remembered_turns(time_s: FloatArray, turned_rad: FloatArray) -> FloatArray:
    """Return how far a vehicle has turned (N,) less what a filter forgot of it, for each memory, (N, 3).

    An autopilot integrates the gyro, whose scale s is off, and follows a compass that is late: its yaw errs
    by e' = s w - (e + late w) / T, which is s - late / T times what is returned here.
    """
    turned = turned_rad[:, None]
    forgotten = [first_order_lag(time_s, turned, memory_s)[0] for memory_s in _TURN_MEMORIES_S]
    return np.asarray(turned - np.hstack(forgotten))


def _blank(count: int, rows: int) -> FloatArray:
    return np.zeros((count, rows, _STATES))
