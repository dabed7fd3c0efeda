"""The noise floor: scatter and correlation of each sensor when nothing is wrong, and its removal."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import Group
from mavcompass.simulation.physics.signals import Reading

# Readings that a recursion filters at once.
_STRETCH = 32


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """Hold one sensor's noise: e_t = sum of coefficients_i e_(t-i) + sigma (n_t - moving n_(t-1)), n white.

    With one coefficient and a moving part it is white scatter on a slowly wandering error.

    Attributes:
        coefficients: the correlation of each channel, (p, 3).
        sigma: the innovations' standard deviation per channel, (3,).
        rms: the noise's own standard deviation per channel, (3,).
        samples: how many innovations they were estimated from (infinite: stated, not measured).
        moving: the moving-average part of each channel, (3,), 0 <= moving < 1.
        row_scale: how much larger the innovation of each row is, (N, 3); None for even noise.
        channels: from the sensor's axes to the channels, (N, 3, 3); None where the axes are the channels. An
            attitude's error turns the field: it has no part along it.
        begins: rows that nothing before tells of, in ascending order: a silence ended there.
    """

    coefficients: FloatArray
    sigma: FloatArray
    rms: FloatArray
    samples: float
    row_scale: FloatArray | None = None
    moving: FloatArray = field(default_factory=lambda: np.zeros(3))
    channels: FloatArray | None = None
    begins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def in_channels(self, error: FloatArray) -> FloatArray:
        """Turn errors of the sensor's axes (N, 3) into those of the channels."""
        return error if self.channels is None else np.matmul(self.channels, error[:, :, None])[:, :, 0]

    def whiten(self, error: FloatArray) -> FloatArray:
        """Return innovations in sigmas, (N, 3); the first p rows are those of an infinite past of zeros."""
        return self.whiten_many(error[:, :, None])[:, :, 0]

    def whiten_many(self, errors: FloatArray) -> FloatArray:
        """Return innovations in sigmas of many errors at once, (N, 3, K)."""
        if self.channels is None:
            scaled = errors / self.sigma[:, None]
        else:
            scaled = np.matmul(self.channels, errors)
            scaled /= self.sigma[:, None]
        out = self.decorrelated(scaled)
        if self.row_scale is not None:
            # What scatters more has no part in what wanders: only the innovations are scaled.
            out /= self.row_scale[:, :, None]
        return out

    def decorrelated(self, columns: FloatArray) -> FloatArray:
        """Take each channel's correlation out of its columns (N, 3, K), whose scale stays.

        Columns (N, 1, K) belong to every channel.
        """
        if not self.begins.size:
            return self._in_a_piece(columns)
        out = np.concatenate([self._in_a_piece(piece) for piece in np.split(columns, self.begins)])
        out[self.begins] = columns[self.begins] * (self.sigma / self.rms)[:, None]
        return out

    def _in_a_piece(self, columns: FloatArray) -> FloatArray:
        n, _, k = columns.shape
        flat = np.broadcast_to(columns, (n, 3, k)).reshape(n, -1)
        out = flat.copy()
        for lag, coefficients in enumerate(self.coefficients, start=1):
            out[lag:] -= np.repeat(coefficients, k) * flat[:-lag]
        if self.moving.any():
            # What the first reading tells of the second: the best linear prediction of a stationary error.
            out[0] *= np.repeat(np.where(self.moving > 0.0, (self.sigma / self.rms) ** 2, 1.0), k)
            return recursive(self.moving, out.reshape(n, 3, k))
        return out.reshape(n, 3, k)

    @property
    def square_inflation(self) -> float:
        """Return by how much the correlation inflates the variance of a mean of squares."""
        m = self.moving
        rho = np.minimum(self.coefficients.sum(axis=0), np.where(m == 0.0, 0.97, 0.999))
        # Autocorrelations of ARMA(1, 1): r_1, r_1 rho, r_1 rho^2 ...; r_1 is rho without a moving part.
        first = (rho - m) * (1.0 - rho * m) / (1.0 + m * m - 2.0 * rho * m)
        return float(np.mean(1.0 + 2.0 * first**2 / (1.0 - rho * rho)))


Noise = dict[Group, SensorNoise]


def recursive(factors: FloatArray, columns: FloatArray) -> FloatArray:
    """Return y_t = x_t + factor y_(t-1) of columns (N, c, k), from y_(-1) = 0, with factors (c,).

    Stretches are filtered at once, as products with powers of the factor; what a stretch ends with goes on
    in the next.
    """
    count, channels, width = columns.shape
    padded = np.empty((-(-count // _STRETCH), _STRETCH, channels, width))
    rows = padded.reshape(-1, channels, width)
    rows[:count], rows[count:] = columns, 0.0
    powers = np.stack([_powers(factor) for factor in factors.tolist()])
    out = powers @ padded.transpose(0, 2, 1, 3)
    fading = powers[:, :, :1] * factors[:, None, None]
    for before, after in pairwise(out):
        after += fading * before[:, -1:]
    return out.transpose(0, 2, 1, 3).reshape(-1, channels, width)[:count]


@lru_cache(maxsize=256)
def _powers(factor: float) -> FloatArray:
    """Return what each reading of a stretch takes of those before it."""
    apart = np.subtract.outer(np.arange(_STRETCH), np.arange(_STRETCH))
    return np.tril(factor ** np.maximum(apart, 0))


def group_values(reading: Reading, group: Group) -> FloatArray:
    """Return what one sensor says, (N, 3)."""
    if group == "mag":
        return reading.mag_mgauss
    return reading.acc_mps2 if group == "acc" else reading.gyro_radps


def estimate_noise(
    error: FloatArray, usable: NDArray[np.bool_], least_sigma: float, channels: FloatArray | None = None
) -> SensorNoise:
    """Estimate one sensor's noise from errors (N, 3) on usable rows, the kind of correlation by BIC.

    Either a few lags, or white scatter on an error that wanders for seconds (an attitude's does): alike in
    all axes, or of its own kind in each of the `channels` (N, 3, 3). `least_sigma` is what the resolution
    alone makes.
    """
    if channels is None:
        return _estimated(error, usable, least_sigma)
    values = np.matmul(channels, np.nan_to_num(error)[:, :, None])[:, :, 0]
    each = [_estimated(values[:, [c]], usable, least_sigma) for c in range(3)]
    lags = max(one.coefficients.shape[0] for one in each)
    coefficients = np.zeros((lags, 3))
    for c, one in enumerate(each):
        coefficients[: one.coefficients.shape[0], c] = one.coefficients[:, 0]
    return SensorNoise(
        coefficients,
        np.array([one.sigma[0] for one in each]),
        np.array([one.rms[0] for one in each]),
        each[0].samples,
        moving=np.array([one.moving[0] for one in each]),
        channels=channels,
    )


def _estimated(error: FloatArray, usable: NDArray[np.bool_], least_sigma: float) -> SensorNoise:
    """Estimate noise that is alike in all columns of errors (N, k)."""
    rows = error[usable]
    rows = rows - rows.mean(axis=0)
    scale = np.maximum(rows.std(axis=0), least_sigma)
    most = usual.noise.lags if len(rows) > 200 else 1
    together = usable.copy()
    for lag in range(1, most + 1):
        together[lag:] &= usable[:-lag]
        together[:lag] = False
    index = np.flatnonzero(together)
    coefficients, moving, sigma, samples = np.zeros(0), 0.0, scale, max(len(rows), 1)
    if index.size >= 50:
        z = (error - error[usable].mean(axis=0)) / scale
        criterion, coefficients, innovations = _of_few_lags(z, index, most)
        slow = _wandering_part(z, usable, index)
        if slow is not None and slow[0] < criterion:
            coefficients, moving, innovations = np.array([slow[1]]), slow[2], slow[3]
        sigma, samples = np.maximum(innovations.std(axis=0) * scale, least_sigma), index.size
    width = error.shape[1]
    repeated = np.repeat(coefficients[:, None], width, axis=1)
    return SensorNoise(repeated, sigma, scale, float(samples), moving=np.full(width, moving))


def _of_few_lags(z: FloatArray, index: NDArray[np.int64], most: int) -> tuple[float, FloatArray, FloatArray]:
    """Return BIC, coefficients and innovations of the likeliest correlation over up to so many lags."""
    target = z[index].ravel()
    past = np.stack([z[index - lag].ravel() for lag in range(1, most + 1)], axis=1)
    best = (float(target.size * np.log(max(float(np.mean(target**2)), 1e-300))), np.zeros(0))
    normal, right = past.T @ past, past.T @ target
    for order in range(1, most + 1):
        coefficients = np.linalg.solve(normal[:order, :order] + 1e-12 * np.eye(order), right[:order])
        left = float(np.mean((target - past[:, :order] @ coefficients) ** 2))
        criterion = float(target.size * np.log(max(left, 1e-300)) + 2.0 * order * np.log(target.size))
        if criterion < best[0]:
            best = (criterion, np.asarray(coefficients))
    return *best, (target - past[:, : best[1].size] @ best[1]).reshape(index.size, -1)


def _wandering_part(
    z: FloatArray, usable: NDArray[np.bool_], index: NDArray[np.int64]
) -> tuple[float, float, float, FloatArray] | None:
    """Return BIC, correlation, moving part and innovations of the likeliest white scatter on a slow error.

    That is ARMA(1, 1), of a memory that the recording holds often enough.
    """
    held = z[np.maximum.accumulate(np.where(usable, np.arange(len(z)), 0))]
    found: list[tuple[float, float, float, FloatArray]] = []
    for memory in usual.noise.memories:
        if memory * usual.noise.fewest_memories > index.size:
            break
        correlation = 1.0 - 1.0 / memory
        for gain in usual.noise.gains:
            moving = correlation * (1.0 - gain)
            news = held.copy()
            news[1:] -= correlation * held[:-1]
            left = recursive(np.array([moving]), news[:, None])[index, 0]
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


def white(sigma: FloatArray) -> SensorNoise:
    """Return uncorrelated noise of a stated standard deviation per axis."""
    return SensorNoise(np.zeros((0, 3)), sigma, sigma, np.inf)


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
