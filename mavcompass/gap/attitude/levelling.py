"""A first attitude from gyro, accelerometer and a satellite receiver, from which the smoother starts.

Turned by the integrated gyro into axes that stand still, down stands still too, but for the gyro's drift.
What the accelerometer feels there is gravity and the vehicle's acceleration, and averages of an
acceleration over a time T are no larger than a change of the velocity over T: so it is averaged over
long windows, nothing left out, after the receiver's acceleration has been taken away where there is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import integrated, turned_about_down, with_down
from mavcompass.gap.attitude.receiver import Velocity, triangle_means
from mavcompass.gap.attitude.scatter import Bias
from mavcompass.gap.attitude.smoother import Sensed
from mavcompass.simulation.effects.rotations import skew
from mavcompass.track import Track, uncut
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


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Hold a first attitude at the gyro's times.

    Attributes:
        rotation: body to NED where `bearing` is known, else to a level frame of any yaw, (N, 3, 3).
        bearing: True where the receiver's velocity explains the forces that are felt, and told the yaw.
    """

    rotation: FloatArray
    bearing: bool


def sensed_by(track: Track) -> Sensed | None:
    """Return what gyro and accelerometer say; None where the recording lacks either."""
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
    force = uncut(np.where(felt[:, None], force, 0.0), track.acc_truncation_mps2)
    return Sensed(
        clock, uncut(track.gyro_radps.values[finite][first], track.gyro_truncation_radps), force, felt
    )


def started(data: Sensed, resting: Bias, velocity: Velocity | None, autopilot: FloatArray | None) -> Start:
    """Start from an autopilot's attitude (N, 3, 3) where there is one, else by levelling the gyro."""
    if autopilot is None:
        return _levelled(data, resting, velocity)
    # Only a start: it goes on where readings were lost, and its level is about right.
    bearing = None if velocity is None else velocity.bearing(data.time_s, autopilot, data.force_mps2, 0.0)
    rotation = autopilot if bearing is None else turned_about_down(autopilot, -bearing)
    return Start(rotation, bearing is not None)


def _levelled(data: Sensed, resting: Bias, velocity: Velocity | None) -> Start:
    """Find the receiver's bearing, the gyro's bias and the level by turns, from the rest's bias on."""
    linear = np.zeros_like(data.force_mps2)
    bias, bearing = resting.mean, None
    there = _still_axes(data, bias)
    for turn in range(_PASSES):
        if turn > 0:
            prior = Bias(resting.mean - bias, resting.sigma)
            bias = bias + _leaning_bias(data, there, _felt_there(data, there) - linear, prior)
            again = _still_axes(data, bias)
            linear = np.einsum("nij,nkj,nk->ni", again, there, linear)
            there = again
        gravity = _felt_there(data, there) - linear
        half_s = _half_window_s(data, there, gravity)
        down = _smoothed_down(data, there, gravity, half_s)
        rotation = with_down(data.time_s, data.rate_radps - bias, down)
        if velocity is not None:
            absorbed = half_s if bearing is None else 0.0
            bearing = velocity.bearing(data.time_s, rotation, data.force_mps2, absorbed)
            if bearing is not None:
                # From the receiver's axes back into those that stand still.
                turned = turned_about_down(rotation, -bearing)
                acceleration = velocity.acceleration(data.time_s)
                linear = np.einsum("nij,nkj,nk->ni", there, turned, acceleration)
    if bearing is not None:
        rotation = turned_about_down(rotation, -bearing)
    return Start(rotation, bearing is not None)


def _still_axes(data: Sensed, bias: FloatArray) -> FloatArray:
    """Integrate the gyro without a bias: body to axes that stand still, (N, 3, 3)."""
    return integrated(data.time_s, data.rate_radps - bias)


def _felt_there(data: Sensed, there: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", there, data.force_mps2))


def _leaning_bias(data: Sensed, there: FloatArray, gravity: FloatArray, prior: Bias) -> FloatArray:
    """Return the change of the gyro's bias (3,) that makes down stand still.

    With true rotations (1 + [phi]x) R, phi' = -R b, gravity is -g d there, or R f = -g d + g [d]x C b
    with C the integral of R: linear in d and b.
    """
    step = np.diff(data.time_s, prepend=data.time_s[0])[:, None, None]
    turned = np.cumsum(there * step, axis=0)
    mean = gravity[data.felt].mean(axis=0)
    d = -mean / max(float(np.linalg.norm(mean)), 1e-9)
    leaning = STANDARD_GRAVITY_MPS2 * np.einsum("ij,njk->nik", skew(d), turned[data.felt])
    design = (leaning - leaning.mean(axis=0)).reshape(-1, 3)
    target = (gravity[data.felt] - mean).reshape(-1)
    # Only one value in each memory of the accelerations is news, and a turn's acceleration can look like a
    # bias: all of what varies, in two directions, counts as noise.
    news = min(float(np.median(np.diff(data.time_s))) / _MEMORY_S, 1.0)
    weight = news / max(float(target @ target) / int(data.felt.sum()) / 2.0, 1e-6)
    precision = weight * design.T @ design + np.diag(prior.sigma**-2)
    right = weight * design.T @ target + prior.mean / prior.sigma**2
    return np.asarray(np.linalg.solve(precision, right))


def _half_window_s(data: Sensed, there: FloatArray, gravity: FloatArray) -> float:
    """Return the half window that loses least between accelerations and the gyro's drift.

    An acceleration a that lasts for tau tilts the mean over T by a tau / (g T), a drift b by b T / 4 at the
    ends: least at T = 2 sqrt(a tau / (g b)).
    """
    quick, slow = (_smoothed_down(data, there, gravity, s) for s in (_QUICK_S, _LONGEST_S))
    leaning = math.sqrt(float(np.mean(np.sum((quick - slow) ** 2, axis=1))))
    best = 2.0 * math.sqrt(leaning * _MEMORY_S / _WANDERING_RADPS)
    return min(max(best, _SHORTEST_S), _LONGEST_S)


def _smoothed_down(data: Sensed, there: FloatArray, gravity: FloatArray, half_s: float) -> FloatArray:
    """Return the down vector in body axes, (N, 3): gravity averaged over both sides of each time."""
    down = -gravity * data.felt[:, None]
    # Where nothing was felt nearby, the average of all is the best there is.
    total = triangle_means(data.time_s, down, half_s) + 1e-6 * down.mean(axis=0)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.einsum("nji,nj->ni", there, total))
