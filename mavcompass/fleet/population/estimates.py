"""What the rows of a fleet's diagnoses tell of each vehicle: quantities with their covariances.

Their distribution is found by partial pooling, of a quantity over vehicles, each known with an error of its
own:

    x_v = m + d_v + e_v,    d_v ~ Student t (0, spread; 4 degrees of freedom),    e_v ~ N(0, S_v)

Each vehicle counts by what is known of it, and for less the further it lies out (Lange, Little and Taylor
1989, with S_v beside the spread in every weight). All distances are then set so that half of the vehicles lie
within the median of a normal distribution: what lies far out does not shorten them.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.fleet.examine import Row
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


# Quantities that every vehicle has: which of the iron's values they are, and what a person calls them.
IRON = {
    "hard_iron": (slice(0, 3), "hard iron"),
    "soft_iron": (slice(3, 9), "gains and cross terms"),
    "motor_current": (slice(9, 12), "field of the battery current"),
}
# Quantities of which more is worse, as logarithms; what is known of one recording's, as a share.
SIZES = {
    "scatter_mgauss": ("scatter of the readings", 0.05),
    "field_gap_mgauss": ("difference to the simulation", 0.2),
}

# A field of the motors that is known no better was not recorded.
_UNTOLD_MGAUSS_PER_A = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Hold one quantity of one vehicle: value (k,) and covariance (k, k)."""

    value: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """Hold what is known of one compass of one vehicle.

    Attributes:
        quantities: by name, those of `IRON` and `SIZES`. effects: causes named in most of its recordings,
            parameters by name as value and sigma.
        recordings: how many were diagnosed.
    """

    name: str
    compass: int
    quantities: Mapping[str, Known]
    effects: Mapping[str, Mapping[str, tuple[float, float]]]
    recordings: int


def vehicles_of(rows: Sequence[Row]) -> list[Vehicle]:
    """Collect the diagnosed vehicles, compass by compass, from the rows of `examine`."""
    by_vehicle: dict[tuple[str, int], list[Row]] = defaultdict(list)
    for row in rows:
        if row["status"] == "ok" and row.get("verdict") is not None and row.get("iron_json"):
            by_vehicle[row["vehicle"], row["compass"]].append(row)
    return [_vehicle(name, compass, own) for (name, compass), own in sorted(by_vehicle.items())]


def _vehicle(name: str, compass: int, rows: Sequence[Row]) -> Vehicle:
    irons = [json.loads(row["iron_json"]) for row in rows]
    # Recordings of a vehicle share its calibration in force, so that their errors are not independent.
    value = np.median([iron["values"] for iron in irons], axis=0)
    covariance = np.mean([iron["covariance"] for iron in irons], axis=0)
    known = {key: Known(value[part], covariance[part, part]) for key, (part, _) in IRON.items()}
    if float(np.diag(known["motor_current"].covariance).max()) > _UNTOLD_MGAUSS_PER_A**2:
        del known["motor_current"]
    for key, (_, share) in SIZES.items():
        sizes = [math.log(max(_size(row, key), 1e-3)) for row in rows if row.get(key) is not None]
        if sizes:
            known[key] = Known(np.array([np.median(sizes)]), np.array([[share**2]]))
    found: dict[str, list[Mapping[str, tuple[float, float]]]] = defaultdict(list)
    for row in rows:
        for cause in json.loads(row["causes_json"]):
            found[cause["effect"]].append(_parameters(cause))
    usual = {effect: cases[-1] for effect, cases in found.items() if 2 * len(cases) > len(rows)}
    return Vehicle(name, compass, known, usual, len(rows))


def _size(row: Row, key: str) -> float:
    """Return a size; what a named effect explains counts where the held-out parts did not see it."""
    named = [value for name, value in row.items() if name.startswith("effect_") and value is not None]
    return max([row[key], *named]) if key == "field_gap_mgauss" else float(row[key])


def _parameters(cause: Mapping[str, object]) -> dict[str, tuple[float, float]]:
    values, intervals = cause["parameters"], cause["ci95"]
    assert isinstance(values, dict) and isinstance(intervals, dict)
    return {
        name: (float(value), (intervals[name][1] - intervals[name][0]) / (2.0 * 1.96))
        for name, value in values.items()
        if value is not None and None not in intervals[name]
    }
