"""Which vehicle is not like the others: quantity by quantity, against the distribution over the fleet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.fleet.population.estimates import IRON, SIZES, Vehicle
from mavcompass.fleet.population.pooling import Pooled

# So many names are expected of a whole fleet in which nothing is odd.
FALSE_NAMES = 0.05
# Fleets have longer tails than a normal distribution: those of Student's t.
_TAILS = 20.0
_FEWEST = 12
# What differs by less moves no heading by a degree, however surely it differs: mG, shares, mG/A at some ten
# amperes; of scatter and gap what is more, in mG.
_MATERIAL = {
    "hard_iron": 5.0,
    "soft_iron": 0.02,
    "motor_current": 0.3,
    "scatter_mgauss": 4.0,
    "field_gap_mgauss": 4.0,
}


@dataclass(frozen=True, slots=True)
class Odd:
    """Hold a vehicle that is not like the others.

    Attributes:
        vehicle, compass: which. quantity: what is odd about it, `words` says how.
        sigmas: how far out it lies. p: the chance of one so far out, of all vehicles and quantities together.
    """

    vehicle: str
    compass: int
    quantity: str
    words: str
    sigmas: float
    p: float


def odd_ones(vehicles: Sequence[Vehicle], pooled: Mapping[str, Pooled]) -> tuple[Odd, ...]:
    """Name the vehicles that lie materially further out than chance puts one of them, the furthest first."""
    if len(vehicles) < _FEWEST:
        return ()
    found = [odd for quantity in pooled for odd in _of(quantity, vehicles, pooled)]
    return tuple(sorted(found, key=lambda odd: -odd.sigmas))


def _of(quantity: str, vehicles: Sequence[Vehicle], pooled: Mapping[str, Pooled]) -> Iterator[Odd]:
    from scipy.special import fdtrc

    fleet, tests = pooled[quantity], len(vehicles) * len(pooled)
    with_it = [vehicle for vehicle in vehicles if quantity in vehicle.quantities]
    k = fleet.location.size
    for vehicle, distance2 in zip(with_it, fleet.distance2.tolist(), strict=True):
        value = vehicle.quantities[quantity].value
        if quantity in SIZES and value[0] <= fleet.location[0]:
            continue
        if _apart(quantity, value, fleet.location) < _MATERIAL[quantity]:
            continue
        p = float(fdtrc(k, _TAILS, distance2 / k)) * tests
        if p < FALSE_NAMES:
            words = _words(quantity, value, fleet.location)
            yield Odd(vehicle.name, vehicle.compass, quantity, words, float(np.sqrt(distance2)), p)


def _apart(quantity: str, value: np.ndarray, usual: np.ndarray) -> float:
    if quantity in SIZES:
        more, like = np.exp(2.0 * value[0]), np.exp(2.0 * usual[0])
        return float(np.sqrt(more - like))
    return float(np.linalg.norm(value - usual))


def _words(quantity: str, value: np.ndarray, usual: np.ndarray) -> str:
    if quantity in SIZES:
        said, like = np.exp([value[0], usual[0]]).tolist()
        return f"{SIZES[quantity][0]} of {said:.1f} mG, usually {like:.1f}"
    unit, digits = {"hard_iron": (" mG", 0), "soft_iron": ("", 3), "motor_current": (" mG/A", 2)}[quantity]
    said, like = (", ".join(f"{v:.{digits}f}" for v in vector.tolist()) for vector in (value, usual))
    return f"{IRON[quantity][1]} of ({said}){unit}, usually ({like})"
