"""The yaw that the integrated gyro lacks, smoothed from all that knows it, with its covariance over time.

What the integral of the yaw rate does not know is

    e(t) = c + b t + s psi(t) + l psi'(t) + w(t)

with a constant, the gyro's even drift, its scale, the age of its readings, and an integrated random walk w,
since a bias wanders. A witness says psi + e + n, with n its own error: a constant, an error that lasts for
some seconds (an attitude filter's) and white scatter, of sizes that the recording itself makes likeliest.
Everything is linear and normal, so that the smoothed error has a closed form (Rauch, Tung and Striebel's
smoother, in one step), and its covariance goes into the diagnosis as a few curves with normal amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray

# A priori: gyro scale, age of its readings beside the witness's, wander of a bias in rad/s per root second.
_SCALE = 0.01
_AGE_S = 0.1
_LEAST_DRIFT_RADPS = math.radians(0.1)
_WANDER = math.radians(0.01)
# The walk of an angle that is summed up from noisy rates, rad per root second.
_WALK = math.radians(0.03)
_SLOW_S = 40.0
_AGE, _KNOWN_AGE_S = 2, 0.01
_AGE_STEP_S, _LONGEST_AGE_S, _LEAST_TURNING_RADPS = 0.01, 0.2, 0.05
_KNOTS = 96
_MOST_WANDERING = 32
_WITNESSED_EVERY_S = 1.0
_MOST_WITNESSED = 500
# What a witness's lasting error may be, rad.
_LASTING = np.radians([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4])
# Curves smaller than this are of no consequence: a tenth of a milligauss.
_LEAST_CURVE = math.radians(0.02)


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """Hold what a witness says of the yaw beside the gyro's integral.

    `ahead_rad` (M,) is its yaw less the integral at `time_s` (M,); `constant_rad` and `scatter_rad` are the
    standard deviations of its constant error and of its white scatter; its other error lasts for `memory_s`.
    `slow_rad` is what wanders more slowly, where no other witness could tell it from the gyro's drift.
    """

    time_s: FloatArray
    ahead_rad: FloatArray
    constant_rad: float
    scatter_rad: float
    memory_s: float
    slow_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class YawError:
    """Hold the smoothed error of the integrated yaw at the gyro's times.

    Attributes:
        mean_rad: (N,), to be added to the integral.
        curves_rad: (N, k), what remains unknown: each has a standard normal amplitude.
        constant_sigma_rad: standard deviation of a constant besides.
    """

    mean_rad: FloatArray
    curves_rad: FloatArray
    constant_sigma_rad: float


def age_of(clock: FloatArray, rate: FloatArray, when: FloatArray, yaw: FloatArray) -> float | None:
    """Return how late a rate (N,) is beside the rate of another yaw (M,), seconds; None where little turns.

    What bends that yaw with the heading changes how fast it turns, by sines of it, and not when: of all ages
    that one is right which leaves least beside such a bend.
    """
    step = max(float(np.median(np.diff(clock))), _AGE_STEP_S)
    grid = np.arange(max(clock[0], when[0]), min(clock[-1], when[-1]), step)
    if grid.size < 100:
        return None
    heading = np.interp(grid, when, yaw)
    other = np.gradient(heading, step)
    if float(other.std()) < _LEAST_TURNING_RADPS:
        return None
    lags = np.arange(-_LONGEST_AGE_S, _LONGEST_AGE_S + 1e-9, _AGE_STEP_S)
    edge = round(_LONGEST_AGE_S / step) + 1
    inner = slice(edge, -edge)
    bends = np.stack(
        [np.ones_like(heading), *(f(k * heading) for k in (1, 2) for f in (np.cos, np.sin))], axis=1
    )
    left = []
    for lag in lags:
        design = (np.interp(grid + lag, clock, rate)[:, None] * bends)[inner]
        normal = design.T @ design + 1e-9 * np.eye(bends.shape[1])
        score = design.T @ other[inner]
        left.append(float(other[inner] @ other[inner] - score @ np.linalg.solve(normal, score)))
    best = int(np.argmin(left))
    return float(lags[best]) if 0 < best < lags.size - 1 else None


def smoothed(
    clock: FloatArray, yaw: FloatArray, drift_sigma_radps: float, witnesses: Sequence[Witness], unknown_rad:
    float, age_s: float | None = None,
) -> YawError:  # fmt: skip
    """Smooth the error of an integrated yaw (N,) over all witnesses; `unknown_rad` is its constant's sigma.

    `age_s` is how late the gyro is, where that is known from elsewhere.
    """
    basis, sigma = _basis(clock, yaw, drift_sigma_radps)
    prior_mean = np.zeros(sigma.size)
    if age_s is not None:
        prior_mean[_AGE], sigma[_AGE] = age_s, _KNOWN_AGE_S
    precision, right = np.diag(sigma**-2.0), prior_mean * sigma**-2.0
    constant, mean0 = unknown_rad, 0.0
    for witness in witnesses:
        when, ahead = _thinned(witness)
        if when.size < 8:
            continue
        H = np.stack([np.interp(when, clock, column) for column in basis.T], axis=1)
        # The constant belongs to the witness and the gyro together: free in the fit, its sigma told apart.
        design = np.column_stack([np.ones(when.size), H])
        prior = np.concatenate([[math.radians(180.0) ** -2.0], np.zeros(sigma.size)])
        whole = np.diag(prior)
        whole[1:, 1:] = precision
        covariance = _lasting_covariance(witness, when, ahead, design, whole)
        weight = np.linalg.solve(covariance, design)
        whole = whole + design.T @ weight
        solution = np.linalg.solve(whole, weight.T @ ahead + np.concatenate([[0.0], right]))
        if witness.constant_rad < constant:
            constant, mean0 = witness.constant_rad, float(solution[0])
        # Without the constant: Schur's complement.
        precision = whole[1:, 1:] - np.outer(whole[1:, 0], whole[0, 1:]) / whole[0, 0]
        right = precision @ solution[1:]
    mean = np.linalg.solve(precision, right)
    root = np.linalg.cholesky(np.linalg.inv(precision) + 1e-18 * np.eye(sigma.size))
    return YawError(mean0 + basis @ mean, _curves(basis @ root), constant)


def _basis(clock: FloatArray, yaw: FloatArray, drift_sigma: float) -> tuple[FloatArray, FloatArray]:
    """Return drift, scale, age and wander as columns (N, p) about their means, and their prior sigmas
    (p,)."""
    t = clock - 0.5 * (clock[0] + clock[-1])
    columns = [t, yaw - yaw.mean(), np.gradient(yaw, clock)]
    # A vehicle that seems to rest may turn slowly: a bias is never known better than this.
    sigmas = [max(drift_sigma, _LEAST_DRIFT_RADPS), _SCALE, _AGE_S]
    span = float(clock[-1] - clock[0])
    knots = np.linspace(0.0, span, _KNOTS)
    low, high = np.minimum.outer(knots, knots), np.maximum.outer(knots, knots)
    wander = _WANDER**2 * low**2 * (3.0 * high - low) / 6.0 + _WALK**2 * low
    straight = np.column_stack([np.ones(_KNOTS), knots])
    out = np.eye(_KNOTS) - straight @ np.linalg.pinv(straight)
    values, vectors = np.linalg.eigh(out @ wander @ out)
    for value, vector in list(zip(values, vectors.T, strict=True))[::-1][:_MOST_WANDERING]:
        size = math.sqrt(max(float(value), 0.0) / _KNOTS)
        if size < 0.3 * _LEAST_CURVE:
            break
        columns.append(np.interp(clock - clock[0], knots, vector * math.sqrt(_KNOTS)))
        sigmas.append(size)
    basis = np.stack(columns, axis=1)
    return basis - basis.mean(axis=0), np.array(sigmas)


def _thinned(witness: Witness) -> tuple[FloatArray, FloatArray]:
    """Average what a witness says over a second each, or longer for long recordings."""
    span = float(witness.time_s[-1] - witness.time_s[0])
    bins = np.floor((witness.time_s - witness.time_s[0]) / max(_WITNESSED_EVERY_S, span / _MOST_WITNESSED))
    _, label = np.unique(bins, return_inverse=True)
    count = np.bincount(label)
    return np.bincount(label, witness.time_s) / count, np.bincount(label, witness.ahead_rad) / count


def _lasting_covariance(
    witness: Witness, when: FloatArray, ahead: FloatArray, design: FloatArray, precision: FloatArray
) -> FloatArray:
    """Return the covariance of a witness's errors, with the likeliest size of those that last."""
    apart = np.exp(-np.abs(when[:, None] - when[None, :]) / witness.memory_s)
    scatter = witness.scatter_rad**2 * np.eye(when.size)
    scatter += witness.slow_rad**2 * np.exp(-np.abs(when[:, None] - when[None, :]) / _SLOW_S)
    _, log_prior = np.linalg.slogdet(precision)
    best: tuple[float, FloatArray] | None = None
    for lasting in _LASTING.tolist():
        covariance = lasting**2 * apart + scatter
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, np.column_stack([design, ahead]))
        J, y = white[:, :-1], white[:, -1]
        whole = precision + J.T @ J
        gained = J.T @ y
        _, log_whole = np.linalg.slogdet(whole)
        misfit = float(y @ y - gained @ np.linalg.solve(whole, gained))
        deviance = misfit + 2.0 * float(np.log(np.diag(factor)).sum()) + log_whole - log_prior
        if best is None or deviance < best[0]:
            best = (deviance, covariance)
    assert best is not None
    return best[1]


def _curves(spread: FloatArray) -> FloatArray:
    """Return the fewest curves (N, k) whose sum has the covariance of normal amplitudes on columns (N, p)."""
    values, vectors = np.linalg.eigh(spread.T @ spread)
    keep = np.sqrt(np.maximum(values, 0.0) / len(spread)) > _LEAST_CURVE
    return np.asarray(spread @ vectors[:, keep][:, ::-1])
