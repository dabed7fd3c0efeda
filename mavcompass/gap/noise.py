"""The noise floor: scatter and correlation of each sensor when nothing is wrong, and its removal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import GROUPS, Group
from mavcompass.simulation.signals import Reading

_MOST_LAGS = 4
# Readings that a wandering error lasts, how often the recording must hold that, and how much of an
# innovation stays.
_MEMORIES, _FEWEST_MEMORIES = (10, 20, 40, 80, 160, 320), 12
_GAINS = (0.01, 0.02, 0.04, 0.08, 0.15, 0.3)
# Data sheets state 2 to 4 mG (HMC5883L, QMC5883L, IST8310); no healthy compass scatters by more than ten.
USUAL_SCATTER_MGAUSS = 4.0
WORST_SCATTER_MGAUSS = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """Hold one sensor's noise: e_t = sum of coefficients_i e_(t-i) + sigma (n_t - moving n_(t-1)), n white.

    With one coefficient and a moving part it is white scatter on a slowly wandering error.

    Attributes:
        coefficients: the correlation, common to the axes, (p,).
        sigma: the innovations' standard deviation per axis, (3,).
        rms: the noise's own standard deviation per axis, (3,).
        samples: how many innovations they were estimated from (infinite: stated, not measured).
        moving: the moving-average part, common to the axes, 0 <= moving < 1.
        row_scale: how much larger the innovation of each row is, (N, 3); None for even noise.
    """

    coefficients: FloatArray
    sigma: FloatArray
    rms: FloatArray
    samples: float
    row_scale: FloatArray | None = None
    moving: float = 0.0

    def whiten(self, error: FloatArray) -> FloatArray:
        """Return innovations in sigmas, (N, 3); the first p rows are those of an infinite past of zeros."""
        out = self.decorrelated(error / self.sigma)
        # What scatters more has no part in what wanders: only the innovations are scaled.
        return out if self.row_scale is None else out / self.row_scale

    def decorrelated(self, columns: FloatArray) -> FloatArray:
        """Take the correlation out of columns (N, k), whose scale stays."""
        out = columns.copy()
        for lag, coefficient in enumerate(self.coefficients.tolist(), start=1):
            out[lag:] -= coefficient * columns[:-lag]
        if self.moving > 0.0:
            from scipy.signal import lfilter

            # What the first reading tells of the second: the best linear prediction of a stationary error.
            out[0] *= float(np.mean((self.sigma / self.rms) ** 2))
            out = lfilter([1.0], [1.0, -self.moving], out, axis=0)
        return np.asarray(out)

    def filled(self, error: FloatArray, missing: NDArray[np.bool_], rng: np.random.Generator) -> FloatArray:
        """Return errors (N, 3) whose missing elements are drawn from the noise, given what came before."""
        out, drawn = error.copy(), rng.standard_normal(error.shape)
        scale = self.sigma if self.row_scale is None else self.sigma * self.row_scale
        scale = np.broadcast_to(scale, error.shape)
        last = np.zeros(error.shape[1])
        for t in range(len(out)):
            known = -self.moving * last
            for lag, coefficient in enumerate(self.coefficients[:t].tolist(), start=1):
                known += coefficient * out[t - lag] / scale[t]
            last = np.where(missing[t], drawn[t], out[t] / scale[t] - known)
            out[t] = np.where(missing[t], (known + drawn[t]) * scale[t], out[t])
        return out

    @property
    def square_inflation(self) -> float:
        """Return by how much the correlation inflates the variance of a mean of squares."""
        rho = min(float(self.coefficients.sum()), 0.999) if self.coefficients.size else 0.0
        if self.moving == 0.0:
            rho = min(rho, 0.97)
            return (1.0 + rho * rho) / (1.0 - rho * rho)
        # Autocorrelations of ARMA(1, 1): r_1, r_1 rho, r_1 rho^2 ...
        m = self.moving
        first = (rho - m) * (1.0 - rho * m) / (1.0 + m * m - 2.0 * rho * m)
        return 1.0 + 2.0 * first**2 / (1.0 - rho * rho)


Noise = dict[Group, SensorNoise]


def group_values(reading: Reading, group: Group) -> FloatArray:
    """Return what one sensor says, (N, 3)."""
    if group == "mag":
        return reading.mag_mgauss
    return reading.acc_mps2 if group == "acc" else reading.gyro_radps


def estimate_noise(error: FloatArray, usable: NDArray[np.bool_], least_sigma: float) -> SensorNoise:
    """Estimate one sensor's noise from errors (N, 3) on usable rows, the kind of correlation by BIC.

    Either a few lags, or white scatter on an error that wanders for seconds (an attitude's does).
    `least_sigma` is what the sensor's resolution alone makes.
    """
    rows = error[usable]
    rows = rows - rows.mean(axis=0)
    scale = np.maximum(rows.std(axis=0), least_sigma)
    most = _MOST_LAGS if len(rows) > 200 else 1
    together = usable.copy()
    for lag in range(1, most + 1):
        together[lag:] &= usable[:-lag]
        together[:lag] = False
    index = np.flatnonzero(together)
    if index.size < 50:
        return SensorNoise(np.zeros(0), scale, scale, float(max(len(rows), 1)))
    z = (error - error[usable].mean(axis=0)) / scale
    target = z[index].ravel()
    past = np.stack([z[index - lag].ravel() for lag in range(1, most + 1)], axis=1)
    best = (target.size * np.log(max(np.mean(target**2), 1e-300)), np.zeros(0))
    for order in range(1, most + 1):
        coefficients, *_ = np.linalg.lstsq(past[:, :order], target, rcond=None)
        left = np.mean((target - past[:, :order] @ coefficients) ** 2)
        criterion = target.size * np.log(max(left, 1e-300)) + 2.0 * order * np.log(target.size)
        if criterion < best[0]:
            best = (criterion, np.asarray(coefficients))
    slow = _wandering_part(z, usable, index)
    if slow is not None and slow[0] < best[0]:
        _, correlation, moving, innovations = slow
        sigma = np.maximum(innovations.std(axis=0) * scale, least_sigma)
        return SensorNoise(np.array([correlation]), sigma, scale, float(index.size), moving=moving)
    coefficients = best[1]
    innovations = z[index] - sum(
        (c * z[index - lag] for lag, c in enumerate(coefficients.tolist(), start=1)), np.zeros(3)
    )
    sigma = np.maximum(innovations.std(axis=0) * scale, least_sigma)
    return SensorNoise(coefficients, sigma, scale, float(index.size))


def _wandering_part(
    z: FloatArray, usable: NDArray[np.bool_], index: NDArray[np.int64]
) -> tuple[float, float, float, FloatArray] | None:
    """Return BIC, correlation, moving part and innovations of the likeliest white scatter on a slow error.

    That is ARMA(1, 1), of a memory that the recording holds often enough.
    """
    from scipy.signal import lfilter

    held = z[np.maximum.accumulate(np.where(usable, np.arange(len(z)), 0))]
    found: list[tuple[float, float, float, FloatArray]] = []
    for memory in _MEMORIES:
        if memory * _FEWEST_MEMORIES > index.size:
            break
        correlation = 1.0 - 1.0 / memory
        for gain in _GAINS:
            moving = correlation * (1.0 - gain)
            left = lfilter([1.0, -correlation], [1.0, -moving], held, axis=0)[index]
            criterion = left.size * math.log(max(float(np.mean(left**2)), 1e-300)) + 4.0 * math.log(left.size)
            found.append((criterion, correlation, moving, left))
    return min(found, key=lambda f: f[0]) if found else None


def wandering(scatter: FloatArray, slow: float, correlation: float) -> tuple[FloatArray, float]:
    """Return the innovations' sigma (3,) and the moving part of white scatter (3,) on a slow error.

    The slow error has the standard deviation `slow` and the correlation of neighbours `correlation`. The
    sum is ARMA(1, 1): theta / (1 + theta^2) = rho v / (w + (1 + rho^2) v), v the variance of the scatter, w
    that of the slow error's innovations (Box and Jenkins, Time Series Analysis, section 3.4).
    """
    v, w = float(np.mean(scatter**2)), slow**2 * (1.0 - correlation**2)
    ratio = correlation * v / max(w + (1.0 + correlation**2) * v, 1e-300)
    theta = 0.0 if ratio <= 0.0 else float((1.0 - np.sqrt(max(1.0 - 4.0 * ratio**2, 0.0))) / (2.0 * ratio))
    variance = (w + scatter**2 * (1.0 - theta**2 + (correlation - theta) ** 2)) / (1.0 - theta**2)
    return np.sqrt(variance), theta


def white(sigma: FloatArray, samples: float = np.inf) -> SensorNoise:
    """Return uncorrelated noise of a stated standard deviation per axis."""
    return SensorNoise(np.zeros(0), sigma, sigma, samples)


def rough_sigma(error: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Estimate the white part's sigma per axis from second differences, robustly against slow causes.

    The second difference of white noise has the variance 6 sigma^2; the factor 1.4826 turns a median
    absolute deviation into a standard deviation.
    """
    both = usable[2:] & usable[1:-1] & usable[:-2]
    second = (error[2:] - 2.0 * error[1:-1] + error[:-2])[both]
    if len(second) < 10:
        return np.full(3, np.nan)
    return np.asarray(1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0))


__all__ = [
    "GROUPS",
    "USUAL_SCATTER_MGAUSS",
    "WORST_SCATTER_MGAUSS",
    "Noise",
    "SensorNoise",
    "estimate_noise",
    "group_values",
    "rough_sigma",
    "wandering",
    "white",
]
