"""How far an attitude may be off: a constant of the yaw with what goes with it, curves, the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.kinematics import interpolated
from mavcompass.gap.attitude.navigation import Smoothed

_UNKNOWN_YAW_RAD = math.radians(60.0)
# Curves smaller than this over all are of no consequence: a tenth of a milligauss. Larger ones may last for
# the seconds between two silences, and leave tens of sigmas there.
_LEAST_CURVE_RAD, _MOST_CURVES, _LEAST_CONSTANT_RAD = math.radians(0.015), 200, math.radians(0.5)
# A yaw that is told no better may lie on the wrong side altogether.
_MOST_LINEAR_RAD = math.radians(5.0)
_DOWN = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """Hold what an attitude may be off by, as `Reference` tells it at the same times (N,).

    Rotation vectors are in world axes: `with_yaw` (N, 3) per radian of the yaw's constant, `curves_rad`
    (N, 3, k) of standard normal amplitudes; `rest_rad2` is (3, 3).
    """

    yaw_sigma_rad: float
    with_yaw: FloatArray
    curves_rad: FloatArray
    rest_rad2: FloatArray
    tilt_sigma_rad: float


def doubt_of(smoothed: Smoothed, time_s: FloatArray, told: bool, healthy: bool) -> Doubt:
    """Part an attitude's error at some times (N,); its yaw is `told` by a witness, its gyro is `healthy`.

    At some knots the error is a constant c of the yaw with what goes with it, and modes of what is left
    (principal components of its covariance). Between them it is what it is expected to be beside them
    (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, equation A.6): a level that is
    off by what turns with the vehicle goes round in world axes, which straight lines would not see.
    """
    covariance, some = smoothed.covariance(), smoothed.knots_s[smoothed.some]
    # Knots stand closer where readings were lost: each counts by the time about it.
    share = np.gradient(some) / float(some[-1] - some[0])
    share /= share.sum()
    mean = np.kron(share, _DOWN)
    variance = float(mean @ covariance @ mean)
    sigma = math.hypot(math.sqrt(variance), _LEAST_CONSTANT_RAD)
    told = told and sigma <= _MOST_LINEAR_RAD
    # A constant that nothing tells is no small turn, and takes nothing along; nor does one beside a gyro that
    # is off by degrees a second, of which the smoother's models hold less well.
    tied = told and healthy
    goes = covariance @ mean / variance if tied else np.tile(_DOWN, some.size)
    varying = np.eye(mean.size) - np.outer(goes, mean)
    weight = np.sqrt(np.repeat(share, 3))
    values, vectors = np.linalg.eigh(weight[:, None] * (varying @ covariance @ varying.T) * weight)
    size = np.sqrt(np.maximum(values, 0.0))
    keep = np.flatnonzero(size > _LEAST_CURVE_RAD)[::-1][:_MOST_CURVES]
    small = np.delete(vectors * size, keep, axis=1).reshape(some.size, 3, -1)
    amplitudes = varying.T @ (weight[:, None] * vectors[:, keep]) / size[keep]
    with_sums = smoothed.covariance_with(np.column_stack([mean, amplitudes]))
    goes_on = with_sums[:, :, :1] / variance if tied else np.tile(_DOWN[:, None], (len(with_sums), 1, 1))
    curves = with_sums[:, :, 1:] - goes_on * (mean @ covariance @ amplitudes)
    at_knots = np.concatenate([goes_on - _DOWN[:, None], curves], axis=2)
    then = interpolated(smoothed.knots_s, at_knots.reshape(len(at_knots), -1), time_s)
    then = then.reshape(time_s.size, 3, -1)
    return Doubt(
        yaw_sigma_rad=sigma if told else _UNKNOWN_YAW_RAD,
        with_yaw=then[:, :, 0],
        curves_rad=then[:, :, 1:],
        rest_rad2=np.einsum("kim,kjm->ij", small, small),
        tilt_sigma_rad=float(np.sqrt(np.mean(np.diag(covariance).reshape(-1, 3)[:, :2]))),
    )


# Autopilots without a baseline are seen to be off by ten to forty degrees for minutes, after a knock most of
# all. What changes faster is left to the compass: no turn of the vehicle is swallowed.
_WANDER_RAD, _LENGTH_S, _MOST_LENGTHS = math.radians(20.0), 20.0, 15.0
# Modes smaller than this are of no consequence.
_LEAST_RAD = math.radians(0.1)


def wandering_yaw(time_s: FloatArray) -> FloatArray:
    """Return how a yaw may wander at some times (N,): rotation vectors in world axes, radians, (N, 3, k).

    They are the modes of a smooth process, each with a standard normal amplitude: its covariance is the
    squared exponential (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, equation
    2.31).
    """
    span_s = float(time_s[-1] - time_s[0])
    # A long recording has no more modes than one of some minutes: they cost time.
    length_s = max(_LENGTH_S, span_s / _MOST_LENGTHS)
    count = max(math.ceil(2.0 * span_s / length_s), 3) + 1
    knots = np.linspace(time_s[0], time_s[-1], count)

    def covariance(at_s: FloatArray) -> FloatArray:
        """Return the covariance of the yaw at some times (M,) with that at the knots, (M, K)."""
        return np.asarray(_WANDER_RAD**2 * np.exp(-0.5 * ((at_s[:, None] - knots) / length_s) ** 2))

    values, vectors = np.linalg.eigh(covariance(knots))
    keep = np.flatnonzero(values > count * _LEAST_RAD**2)[::-1]
    # Between the knots the process is what it is expected to be beside them.
    curves = np.zeros((time_s.size, 3, keep.size))
    curves[:, 2] = covariance(time_s) @ vectors[:, keep] / np.sqrt(values[keep])
    return curves
