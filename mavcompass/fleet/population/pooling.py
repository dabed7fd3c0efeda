"""Partial pooling: the distribution of a quantity over vehicles, each known with an error of its own.

    x_v = m + d_v + e_v,    d_v ~ Student t (0, spread; 4 degrees of freedom),    e_v ~ N(0, S_v)

Each vehicle counts by what is known of it, and for less the further it lies out (Lange, Little and Taylor
1989, with S_v beside the spread in every weight). All distances are then set so that half of the vehicles lie
within the median of a normal distribution: what lies far out does not shorten them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray

DEGREES_OF_FREEDOM = 4.0
_ITERATIONS, _SETTLED = 100, 1e-4
_LEAST_SPREAD = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """Hold a quantity of k components over V vehicles.

    Attributes:
        location: (k,). spread: between vehicles, without the errors of knowing them, (k, k).
        distance2: squared, of each vehicle from the location, by spread and its own error, in sigmas, (V,).
        vehicles: how many.
    """

    location: FloatArray
    spread: FloatArray
    distance2: FloatArray

    @property
    def vehicles(self) -> int:
        """Count the vehicles."""
        return int(self.distance2.size)


def pool(values: FloatArray, covariances: FloatArray) -> Pooled:
    """Learn the distribution of values (V, k) with their covariances (V, k, k)."""
    from scipy.special import gammaincinv

    k = values.shape[1]
    location = np.median(values, axis=0)
    mad = 1.4826 * np.median(np.abs(values - location), axis=0)
    spread = np.diag(np.maximum(mad, np.abs(location) * 1e-6 + _LEAST_SPREAD) ** 2)
    for _ in range(_ITERATIONS):
        inverse = np.linalg.inv(spread + covariances)
        away = values - location
        weight = (DEGREES_OF_FREEDOM + k) / (DEGREES_OF_FREEDOM + _squares(away, spread + covariances))
        weighted = weight[:, np.newaxis, np.newaxis] * inverse
        moved = np.linalg.solve(weighted.sum(axis=0), np.einsum("vij,vj->i", weighted, values))
        gain = spread @ inverse
        own = np.einsum("vij,vj->vi", gain, values - moved)
        outer = np.einsum("v,vi,vj->ij", weight, own, own)
        left = (spread - gain @ spread).sum(axis=0)
        wider = (outer + left) / len(values) + _LEAST_SPREAD**2 * np.eye(k)
        change = float(np.abs(wider - spread).max() / np.abs(spread).max())
        location, spread = moved, 0.5 * (wider + wider.T)
        if change < _SETTLED:
            break
    distance2 = _squares(values - location, spread + covariances)
    usual = max(float(np.median(distance2)), _LEAST_SPREAD) / float(2.0 * gammaincinv(0.5 * k, 0.5))
    return Pooled(location, spread * usual, distance2 / usual)


def _squares(away: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return squared distances in sigmas, (V,)."""
    solved = np.linalg.solve(covariances, away[:, :, np.newaxis])[:, :, 0]
    return np.asarray((away * solved).sum(axis=1))
