"""The attitude that gyro, accelerometer and a satellite receiver give together, but for the initial yaw.

Turned by the integrated gyro into axes that stand still, down stands still too, but for the gyro's drift.
What the accelerometer feels there is gravity and the vehicle's acceleration, and averages of an
acceleration over a time T are no larger than a change of the velocity over T: so it is averaged over
long windows, nothing left out, after the receiver's acceleration has been taken away where there is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import integrated, with_down
from mavcompass.gap.attitude.receiver import Path, receiver_path, triangle_means
from mavcompass.gap.attitude.rest import Bias, bias_at_rest
from mavcompass.track import Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# Half the averaging window, seconds: the shortest and the longest.
_SHORTEST_S, _LONGEST_S = 4.0, 30.0
_QUICK_S = 2.0
_FEWEST = 20
_PASSES = 3
# Accelerations of vehicles come and go within this time.
_MEMORY_S = 5.0
# What remains of a gyro's bias, because it changes on the way.
_WANDERING_RADPS = math.radians(0.05)
_LEAST_DRIFT_RADPS = math.radians(0.02)
# A gyro's scale is off by up to this share of what it says.
_SCALE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """Hold a smoothed attitude on the gyro's clock.

    Attributes:
        clock: seconds, (N,). rotation: body to a level frame of any yaw, (N, 3, 3).
        rate_radps: body rates without the gyro's bias, (N, 3).
        drift_sigma_radps: standard deviation of an even drift of the yaw.
        tilt_sigma_rad: what the averaged accelerometer's direction may be off by: how far windows of the
            whole and of half the length contradict each other.
        moved: True where a receiver's acceleration was taken away.
    """

    clock: FloatArray
    rotation: FloatArray
    rate_radps: FloatArray
    drift_sigma_radps: float
    tilt_sigma_rad: float
    moved: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Inertial:
    """Hold rates and forces (N, 3) on one clock (N,), and the rows where a force was felt (N,)."""

    clock: FloatArray
    rate: FloatArray
    force: FloatArray
    felt: NDArray[np.bool_]

    def still_axes(self, bias: FloatArray) -> FloatArray:
        """Integrate the gyro without a bias: body to axes that stand still, (N, 3, 3)."""
        return integrated(self.clock, self.rate - bias)


def levelled(track: Track) -> Levelled | None:
    """Integrate the gyro and level it by the accelerometer; None where the recording lacks either."""
    if track.gyro_radps is None or track.acc_mps2 is None or len(track.gyro_radps) < _FEWEST:
        return None
    finite = np.isfinite(track.gyro_radps.values).all(axis=1)
    clock, first = np.unique(track.gyro_radps.time_s[finite], return_index=True)
    if clock.size < _FEWEST:
        return None
    force = track.acc_mps2.at(clock)
    felt = np.asarray(np.isfinite(force).all(axis=1))
    if felt.sum() < _FEWEST:
        return None
    # Numbers that were cut toward zero are half a step too small on the average.
    force = _restored(np.where(felt[:, None], force, 0.0), track.acc_truncation_mps2)
    rate = _restored(track.gyro_radps.values[finite][first], track.gyro_truncation_radps)
    data = _Inertial(clock, rate, force, felt)
    return _levelled(data, bias_at_rest(clock, rate, force), receiver_path(track, clock))


def _restored(values: FloatArray, step: float) -> FloatArray:
    return np.asarray(values + 0.5 * step * np.sign(values))


def _levelled(data: _Inertial, resting: Bias, path: Path | None) -> Levelled:
    """Find the receiver's bearing, the gyro's bias and the level by turns, from the rest's bias on."""
    linear = np.zeros_like(data.force)
    bias, moved = resting.mean_radps, False
    covariance = np.diag(resting.sigma_radps**2)
    there = data.still_axes(bias)
    for turn in range(_PASSES):
        if turn > 0:
            prior = Bias(resting.mean_radps - bias, resting.sigma_radps)
            change, covariance = _leaning_bias(data, there, _felt_there(data, there) - linear, prior)
            bias = bias + change
            again = data.still_axes(bias)
            linear = np.einsum("nij,nkj,nk->ni", again, there, linear)
            there = again
        gravity = _felt_there(data, there) - linear
        half_s = _half_window_s(data, there, gravity)
        down = _smoothed_down(data, there, gravity, half_s)
        rotation = with_down(data.clock, data.rate - bias, down)
        if path is None or turn + 1 == _PASSES:
            continue
        turned = path.turned_like(data.clock, rotation, data.force, 0.0 if moved else half_s)
        if turned is not None:
            # From the level frame back into the axes that stand still.
            linear, moved = np.einsum("nij,nkj,nk->ni", there, rotation, turned), True
    shorter = _smoothed_down(data, there, gravity, 0.5 * half_s)
    apart = math.sqrt(float(np.mean(np.sum((shorter - down) ** 2, axis=1))))
    rate = data.rate - bias
    even_turn = abs(float(np.mean(np.einsum("ni,ni->n", rate, down))))
    drift = math.sqrt(float(np.einsum("ni,ij,nj->n", down, covariance, down).mean()))
    drift = max(math.hypot(drift, _SCALE * even_turn), _LEAST_DRIFT_RADPS)
    return Levelled(data.clock, rotation, rate, drift, apart, moved)


def _felt_there(data: _Inertial, there: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", there, data.force))


def _leaning_bias(
    data: _Inertial, there: FloatArray, gravity: FloatArray, prior: Bias
) -> tuple[FloatArray, FloatArray]:
    """Return the change of the gyro's bias (3,) that makes down stand still, and its covariance.

    With true rotations (1 + [phi]x) R, phi' = -R b, gravity is -g d there, or R f = -g d + g [d]x C b
    with C the integral of R: linear in d and b.
    """
    step = np.diff(data.clock, prepend=data.clock[0])[:, None, None]
    turned = np.cumsum(there * step, axis=0)
    mean = gravity[data.felt].mean(axis=0)
    d = -mean / max(float(np.linalg.norm(mean)), 1e-9)
    cross = np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
    leaning = STANDARD_GRAVITY_MPS2 * np.einsum("ij,njk->nik", cross, turned[data.felt])
    design = (leaning - leaning.mean(axis=0)).reshape(-1, 3)
    target = (gravity[data.felt] - mean).reshape(-1)
    # Only one value in each memory of the accelerations is news, and a turn's acceleration can look like a
    # bias: all of what varies, in two directions, counts as noise.
    news = min(float(np.median(np.diff(data.clock))) / _MEMORY_S, 1.0)
    weight = news / max(float(target @ target) / int(data.felt.sum()) / 2.0, 1e-6)
    precision = weight * design.T @ design + np.diag(prior.sigma_radps**-2)
    covariance = np.linalg.inv(precision)
    right = weight * design.T @ target + prior.mean_radps / prior.sigma_radps**2
    return covariance @ right, covariance


def _half_window_s(data: _Inertial, there: FloatArray, gravity: FloatArray) -> float:
    """Return the half window that loses least between accelerations and the gyro's drift.

    An acceleration a that lasts for tau tilts the mean over T by a tau / (g T), a drift b by b T / 4 at the
    ends: least at T = 2 sqrt(a tau / (g b)).
    """
    quick, slow = (_smoothed_down(data, there, gravity, s) for s in (_QUICK_S, _LONGEST_S))
    leaning = math.sqrt(float(np.mean(np.sum((quick - slow) ** 2, axis=1))))
    best = 2.0 * math.sqrt(leaning * _MEMORY_S / _WANDERING_RADPS)
    return min(max(best, _SHORTEST_S), _LONGEST_S)


def _smoothed_down(data: _Inertial, there: FloatArray, gravity: FloatArray, half_s: float) -> FloatArray:
    """Return the down vector in body axes, (N, 3): gravity averaged over both sides of each time."""
    down = -gravity * data.felt[:, None]
    # Where nothing was felt nearby, the average of all is the best there is.
    total = triangle_means(data.clock, down, half_s) + 1e-6 * down.mean(axis=0)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.einsum("nji,nj->ni", there, total))
