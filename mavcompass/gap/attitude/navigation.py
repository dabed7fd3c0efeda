"""One attitude from all that knows it but the compass under test: a first one, smoothed, and its doubt.

The smoother's equations are solved about a first trajectory, and about the corrected one again until nothing
moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray, euler_to_matrix, rotvec_to_matrix
from mavcompass.gap.attitude.chain import Solved
from mavcompass.gap.attitude.kinematics import integrated, interpolated, with_down
from mavcompass.gap.attitude.sensors import Bias, Velocity, triangle_means
from mavcompass.gap.attitude.smoother import ACC, BIAS, PHI, SCALE, Sensed, Smoother, Witness
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import Detector
from mavcompass.track import Track, uncut

_DOWN = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Hold the smoothed attitude.

    Attributes:
        rotation: body to NED, (N, 3, 3). rate_radps: without the gyro's bias and scale error, (N, 3).
        errors: of gyro and accelerometer, means over the recording with their standard deviations.
        knots_s: the smoother's times, (K,). some: those that tell how the error goes, (M,).
        borne_out: False where a receiver's velocity is contradicted.
    """

    rotation: FloatArray
    rate_radps: FloatArray
    errors: Mapping[Detector, Bias]
    knots_s: FloatArray
    some: NDArray[np.int64]
    borne_out: bool
    _solved: Solved
    _excess: float

    def covariance_with(self, sums: FloatArray) -> FloatArray:
        """Return the covariance of the rotation vectors in world axes at all knots with sums of those at
        some, (K, 3, k).

        The sums have weights (3 M, k).
        """
        weights = sums.reshape(self.some.size, 3, -1)
        return self._excess * self._solved.covariance_with(self.some, weights)[:, PHI]


def smoothed_attitude(
    sensed: Sensed, start: FloatArray, resting: Bias, velocity: Velocity | None, witness: Witness | None
) -> tuple[Smoothed, bool] | None:
    """Smooth a first trajectory (N, 3, 3), and again where bias or scale of the gyro show to be a fault's.

    Its yaw must be about that of the velocity, if there is one. Returns also whether the gyro's bias is what
    it was at rest, as far as that may be; None where the velocity is contradicted.
    """

    def again(start: FloatArray, bias: Bias, scale_sigma: float = usual.gyro.scale) -> Smoothed:
        return _smoothed(Smoother(sensed, bias, velocity, witness, scale_sigma), start)

    def healthy(found: Smoothed) -> bool:
        off = np.abs(found.errors["gyro offset"].mean - resting.mean)
        return not bool((off > usual.gyro.strained * resting.sigma).any())

    found, bias = again(start, resting), resting
    if not found.borne_out:
        return None
    if not healthy(found):
        # No healthy gyro then: let it say how far it is off.
        bias = Bias(resting.mean, np.maximum(resting.sigma, usual.gyro.faulty_radps))
        found = again(found.rotation, bias)
    if (np.abs(found.errors["gyro gain"].mean) > usual.gyro.stretched * usual.gyro.scale).any():
        found = again(found.rotation, bias, usual.gyro.faulty_scale)
    return found, healthy(found)


def _smoothed(smoother: Smoother, start: FloatArray) -> Smoothed:
    bound_mps = usual.velocity.usual_mps
    rotation, trust = smoother.through(smoother.at_knots(start)), smoother.full_trust()
    solved: Solved | None = None
    for turn in range(usual.knots.passes):
        chain = smoother.chain(rotation, trust)
        if turn == 1:
            bound_mps = smoother.likeliest_bound(chain)
        solved = smoother.bounded(chain, bound_mps).solve()
        before, trust = trust, smoother.trust(solved)
        phi = solved.states[:, PHI]
        rotation = smoother.through(rotvec_to_matrix(phi) @ smoother.at_knots(rotation))
        # A yaw that nothing fixes drifts on for ever.
        settled = float(np.abs(phi - phi.mean(axis=0)).max()) < usual.knots.settled_rad
        if turn > 0 and settled and float(np.abs(trust - before).max(initial=0.0)) < usual.knots.as_trusted:
            break
    assert solved is not None
    constants, change = solved.constants, solved.states[:, BIAS].mean(axis=0)
    rate = smoother.rate - smoother.between(solved.states[:, BIAS]) - smoother.rate * constants[SCALE]
    middle = np.array([smoother.knots.size // 2])
    variance = solved.covariance_with(middle, np.eye(BIAS.stop)[None])[middle[0], BIAS, BIAS]
    sigma = np.sqrt(np.diag(variance))
    excess = smoother.excess(solved)
    # The constants are a share of what the gyro says, its scale is one of how it turned.
    turned, sigmas = 1.0 - constants[SCALE], np.sqrt(excess * np.diag(solved.constants_covariance))
    errors: dict[Detector, Bias] = {
        "gyro offset": Bias(smoother.bias.mean + change, sigma),
        "gyro gain": Bias(constants[SCALE] / turned, sigmas[SCALE] / turned**2),
        "accelerometer offset": Bias(constants[ACC], sigmas[ACC]),
    }
    return Smoothed(
        rotation, rate, errors, smoother.knots, smoother.telling(), smoother.bears_out(solved), solved, excess
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Doubt:
    """Hold what an attitude may be off by, at some times (M,); rotation vectors are in world axes.

    Attributes:
        yaw_sigma_rad: a priori standard deviation of a constant yaw error (0: none is solved for).
        with_yaw: what else turns with that constant, per radian, (M, 3) or (1, 3): a yaw that is off turns
            what the receiver says of the acceleration, and so the level.
        curves_rad: what else it may be off by, (M, 3, k), the largest first: each curve has a standard normal
            amplitude.
        rest_rad2: covariance of what no curve holds, mean over time, (3, 3).
        tilt_sigma_rad: what roll and pitch show themselves to be off by; 0 where nothing tells.
    """

    yaw_sigma_rad: float = 0.0
    with_yaw: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    curves_rad: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 0)))
    rest_rad2: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    tilt_sigma_rad: float = 0.0


def doubt_of(smoothed: Smoothed, time_s: FloatArray, told: bool, healthy: bool) -> Doubt:
    """Part an attitude's error at some times (N,); its yaw is `told` by a witness, its gyro is `healthy`.

    At some knots the error is a constant c of the yaw with what goes with it, and modes of what is left
    (principal components of its covariance). Between them it is what it is expected to be beside them
    (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, equation A.6): a level that is
    off by what turns with the vehicle goes round in world axes, which straight lines would not see.
    """
    some = smoothed.knots_s[smoothed.some]
    covariance = smoothed.covariance_with(np.eye(3 * some.size))[smoothed.some].reshape(3 * some.size, -1)
    # Knots stand closer where readings were lost: each counts by the time about it.
    share = np.gradient(some) / float(some[-1] - some[0])
    share /= share.sum()
    mean = np.kron(share, _DOWN)
    variance = float(mean @ covariance @ mean)
    sigma = math.hypot(math.sqrt(variance), usual.curves.constant_rad)
    told = told and sigma <= usual.yaw.linear_rad
    # A constant that nothing tells is no small turn, and takes nothing along; nor does one beside a gyro that
    # is off by degrees a second, of which the smoother's models hold less well.
    tied = told and healthy
    goes = covariance @ mean / variance if tied else np.tile(_DOWN, some.size)
    varying = np.eye(mean.size) - np.outer(goes, mean)
    weight = np.sqrt(np.repeat(share, 3))
    values, vectors = np.linalg.eigh(weight[:, None] * (varying @ covariance @ varying.T) * weight)
    size = np.sqrt(np.maximum(values, 0.0))
    keep = np.flatnonzero(size > usual.curves.least_rad)[::-1][: usual.curves.most]
    small = np.delete(vectors * size, keep, axis=1).reshape(some.size, 3, -1)
    amplitudes = varying.T @ (weight[:, None] * vectors[:, keep]) / size[keep]
    with_sums = smoothed.covariance_with(np.column_stack([mean, amplitudes]))
    goes_on = with_sums[:, :, :1] / variance if tied else np.tile(_DOWN[:, None], (len(with_sums), 1, 1))
    curves = with_sums[:, :, 1:] - goes_on * (mean @ covariance @ amplitudes)
    at_knots = np.concatenate([goes_on - _DOWN[:, None], curves], axis=2)
    then = interpolated(smoothed.knots_s, at_knots.reshape(len(at_knots), -1), time_s)
    then = then.reshape(time_s.size, 3, -1)
    return Doubt(
        yaw_sigma_rad=sigma if told else usual.yaw.lost_rad,
        with_yaw=then[:, :, 0],
        curves_rad=then[:, :, 1:],
        rest_rad2=np.einsum("kim,kjm->ij", small, small),
        tilt_sigma_rad=float(np.sqrt(np.mean(np.diag(covariance).reshape(-1, 3)[:, :2]))),
    )


def wandering_yaw(time_s: FloatArray) -> FloatArray:
    """Return how a yaw may wander at some times (N,): rotation vectors in world axes, radians, (N, 3, k).

    They are the modes of a smooth process, each with a standard normal amplitude: its covariance is the
    squared exponential (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, equation
    2.31).
    """
    span_s = float(time_s[-1] - time_s[0])
    # A long recording has no more modes than one of some minutes: they cost time.
    length_s = max(usual.autopilot.wander_s, span_s / usual.curves.lengths)
    count = max(math.ceil(2.0 * span_s / length_s), 3) + 1
    knots = np.linspace(time_s[0], time_s[-1], count)

    def covariance(at_s: FloatArray) -> FloatArray:
        """Return the covariance of the yaw at some times (M,) with that at the knots, (M, K)."""
        return np.asarray(
            usual.autopilot.wander_rad**2 * np.exp(-0.5 * ((at_s[:, None] - knots) / length_s) ** 2)
        )

    values, vectors = np.linalg.eigh(covariance(knots))
    keep = np.flatnonzero(values > count * usual.curves.wander_rad**2)[::-1]
    # Between the knots the process is what it is expected to be beside them.
    curves = np.zeros((time_s.size, 3, keep.size))
    curves[:, 2] = covariance(time_s) @ vectors[:, keep] / np.sqrt(values[keep])
    return curves


def sensed_by(track: Track) -> Sensed | None:
    """Return what gyro and accelerometer say; None where the recording lacks either."""
    if track.gyro_radps is None or track.acc_mps2 is None or len(track.gyro_radps) < usual.gyro.fewest:
        return None
    finite = np.isfinite(track.gyro_radps.values).all(axis=1)
    clock, first = np.unique(track.gyro_radps.time_s[finite], return_index=True)
    if clock.size < usual.gyro.fewest:
        return None
    force = track.acc_mps2.at(clock)
    felt = np.asarray(np.isfinite(force).all(axis=1))
    if felt.sum() < usual.gyro.fewest:
        return None
    # Numbers that were cut toward zero are half a step too small on the average.
    force = uncut(np.where(felt[:, None], force, 0.0), track.acc_truncation_mps2)
    return Sensed(
        clock, uncut(track.gyro_radps.values[finite][first], track.gyro_truncation_radps), force, felt
    )


def started(
    data: Sensed, resting: Bias, velocity: Velocity | None, autopilot: FloatArray | None
) -> tuple[FloatArray, bool]:
    """Return a first attitude, body to NED, (N, 3, 3), and whether the receiver's velocity told its yaw.

    It starts from an autopilot's attitude (N, 3, 3) where there is one, else by levelling the gyro. Where the
    velocity does not explain the forces that are felt, it goes to a level frame of any yaw.
    """
    # Only a start: it goes on where readings were lost, and its level is about right.
    rotation, absorbed_s = (
        (_levelled(data, resting), usual.rest.levelled_s) if autopilot is None else (autopilot, 0.0)
    )
    bearing = None
    if velocity is not None:
        bearing = velocity.bearing(data.time_s, rotation, data.force_mps2, absorbed_s)
    if bearing is not None:
        rotation = euler_to_matrix(0.0, 0.0, -bearing) @ rotation
    return rotation, bearing is not None


def _levelled(data: Sensed, resting: Bias) -> FloatArray:
    """Turn as the gyro says about a down that is gravity averaged over both sides of each time, (N, 3, 3)."""
    rate = data.rate_radps - resting.mean
    there = integrated(data.time_s, rate)
    down = -np.einsum("nij,nj->ni", there, data.force_mps2) * data.felt[:, None]
    # Where nothing was felt nearby, the average of all is the best there is.
    total = triangle_means(data.time_s, down, usual.rest.levelled_s) + 1e-6 * down.mean(axis=0)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return with_down(data.time_s, rate, np.einsum("nji,nj->ni", there, total))
