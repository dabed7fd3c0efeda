"""The noise floor: scatter and correlation of each sensor when nothing is wrong, and its removal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects.effect import GROUPS, Group
from mavcompass.simulation.signals import Reading

_MOST_LAGS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """Hold one sensor's noise: e_t = sum of coefficients_i e_(t-i) + sigma n_t, n white.

    Attributes:
        coefficients: the correlation, common to the axes, (p,).
        sigma: the innovations' standard deviation per axis, (3,).
        rms: the noise's own standard deviation per axis, (3,).
        samples: how many innovations they were estimated from (infinite: stated, not measured).
        row_scale: how much larger the noise of each row is, (N, 3); None for even noise.
    """

    coefficients: FloatArray
    sigma: FloatArray
    rms: FloatArray
    samples: float
    row_scale: FloatArray | None = None

    def whiten(self, error: FloatArray) -> FloatArray:
        """Return innovations in sigmas, (N, 3); the first p rows are those of an infinite past of zeros."""
        if self.row_scale is not None:
            error = error / self.row_scale
        out = error / self.sigma
        for lag, coefficient in enumerate(self.coefficients.tolist(), start=1):
            out[lag:] -= coefficient * error[:-lag] / self.sigma
        return np.asarray(out)


Noise = dict[Group, SensorNoise]


def group_values(reading: Reading, group: Group) -> FloatArray:
    """Return what one sensor says, (N, 3)."""
    if group == "mag":
        return reading.mag_mgauss
    return reading.acc_mps2 if group == "acc" else reading.gyro_radps


def estimate_noise(error: FloatArray, usable: NDArray[np.bool_], least_sigma: float) -> SensorNoise:
    """Estimate one sensor's noise from errors (N, 3) on usable rows, order of correlation by BIC.

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
    best = (target.size * np.log(np.mean(target**2)), np.zeros(0))
    for order in range(1, most + 1):
        coefficients, *_ = np.linalg.lstsq(past[:, :order], target, rcond=None)
        left = np.mean((target - past[:, :order] @ coefficients) ** 2)
        criterion = target.size * np.log(max(left, 1e-300)) + 2.0 * order * np.log(target.size)
        if criterion < best[0]:
            best = (criterion, np.asarray(coefficients))
    coefficients = best[1]
    innovations = z[index] - sum(
        (c * z[index - lag] for lag, c in enumerate(coefficients.tolist(), start=1)), np.zeros(3)
    )
    sigma = np.maximum(innovations.std(axis=0) * scale, least_sigma)
    return SensorNoise(coefficients, sigma, scale, float(index.size))


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


__all__ = ["GROUPS", "Noise", "SensorNoise", "estimate_noise", "group_values", "rough_sigma", "white"]
