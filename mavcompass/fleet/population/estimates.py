"""What the rows of a fleet's diagnoses tell of each vehicle: quantities with their covariances."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.fleet.examine import Row
from mavcompass.frames import FloatArray

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
