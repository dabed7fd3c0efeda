"""The distribution of the effects over a fleet, for domain randomisation: as JSON and as presets.

And which vehicle is not like the others: quantity by quantity, against that distribution.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mavcompass.files import write_text
from mavcompass.fleet.examine import Row
from mavcompass.fleet.population.estimates import (
    DEGREES_OF_FREEDOM,
    IRON,
    SIZES,
    Pooled,
    Vehicle,
    pool,
    vehicles_of,
)
from mavcompass.frames import FloatArray

# So many names are expected of a whole fleet in which nothing is odd.
FALSE_NAMES = 0.05
# Fleets have longer tails than a normal distribution: those of Student's t.
_TAILS = 20.0
_FEWEST_VEHICLES = 12
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
    if len(vehicles) < _FEWEST_VEHICLES:
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


SCHEMA = "mavcompass.fleet-distribution/1"
_FEWEST = 4
_NAMES = {
    "hard_iron": ("x", "y", "z"),
    "soft_iron": ("xx", "yy", "zz", "xy", "xz", "yz"),
    "motor_current": ("x", "y", "z"),
}
# The iron's gains are A; the effect soft_iron is A - I.
_NEUTRAL = {"soft_iron": np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])}


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Hold an effect over the fleet: how many have it, and its parameters' distribution (Student's t).

    `prevalence` is the share of vehicles with its 95 % interval.
    """

    effect: str
    vehicles: int
    prevalence: tuple[float, float, float]
    names: tuple[str, ...]
    location: FloatArray
    spread: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """Hold what was learnt of a fleet.

    Attributes:
        vehicles, recordings: diagnosed ones, compass by compass.
        whole: the iron and the motors' field that every vehicle has: all of it, the calibration's included.
        effects: what was named beside these. sizes: median of scatter and gap, mG, and the spread of its
            logarithm.
        odd: vehicles that are not like the others.
    """

    vehicles: int
    recordings: int
    whole: tuple[Spread, ...]
    effects: tuple[Spread, ...]
    sizes: Mapping[str, tuple[float, float]]
    odd: tuple[Odd, ...]

    def to_json(self) -> dict[str, object]:
        """Return the document `mavcompass.fleet-distribution/1`, plain values only."""
        return {
            "schema": SCHEMA,
            "vehicles": self.vehicles,
            "recordings": self.recordings,
            "family": "multivariate Student t",
            "degrees_of_freedom": DEGREES_OF_FREEDOM,
            "whole": [_spread(spread) for spread in self.whole],
            "effects": [_spread(spread) for spread in self.effects],
            "sizes": {
                name: {"median": median, "log_sigma": sigma} for name, (median, sigma) in self.sizes.items()
            },
            "odd": [asdict(odd) for odd in self.odd],
            "false_names_expected": FALSE_NAMES,
        }

    def preset(self, rng: np.random.Generator) -> list[str]:
        """Draw one vehicle of the fleet: effects as `simulate --effect` reads them."""
        drawn = list(self.whole)
        drawn += [spread for spread in self.effects if rng.random() < spread.prevalence[0]]
        return [_drawn(spread, rng) for spread in drawn]


def learn(rows: Sequence[Row]) -> Distribution:
    """Learn a fleet's distribution from the rows of its diagnoses.

    Partial pooling: each vehicle counts by what is known of it, and for less the further it lies out.
    """
    vehicles = vehicles_of(rows)
    pooled: dict[str, Pooled] = {}
    for quantity in (*IRON, *SIZES):
        known = [v.quantities[quantity] for v in vehicles if quantity in v.quantities]
        if len(known) >= _FEWEST:
            pooled[quantity] = pool(
                np.array([k.value for k in known]), np.array([k.covariance for k in known])
            )
    whole = [
        Spread(
            quantity, fleet.vehicles, _prevalence(fleet.vehicles, fleet.vehicles), _NAMES[quantity],
            fleet.location - _NEUTRAL.get(quantity, 0.0), fleet.spread,
        )
        for quantity, fleet in pooled.items()
        if quantity in IRON
    ]  # fmt: skip
    return Distribution(
        vehicles=len(vehicles),
        recordings=sum(vehicle.recordings for vehicle in vehicles),
        whole=tuple(whole),
        effects=tuple(_effects(vehicles)),
        sizes={
            name: (float(np.exp(pooled[name].location[0])), float(np.sqrt(pooled[name].spread[0, 0])))
            for name in SIZES
            if name in pooled
        },
        odd=odd_ones(vehicles, pooled),
    )


def _effects(vehicles: Sequence[Vehicle]) -> list[Spread]:
    """Describe the effects that were named and are not part of the whole iron."""
    from mavcompass.simulation.effects import get

    out = []
    for effect in sorted({effect for vehicle in vehicles for effect in vehicle.effects}):
        if get(effect).affine or effect in IRON:
            continue
        cases = [vehicle.effects[effect] for vehicle in vehicles if effect in vehicle.effects]
        names = tuple(name for name in get(effect).names if all(name in case for case in cases))
        values = np.array([[case[name][0] for name in names] for case in cases])
        sigmas = np.array([[max(case[name][1], 1e-9) for name in names] for case in cases])
        if len(cases) >= _FEWEST and names:
            fleet = pool(values, np.einsum("vi,ij->vij", sigmas**2, np.eye(len(names))))
            location, spread = fleet.location, fleet.spread
        else:  # too few to tell how they differ: as much as they are known, or lie apart
            location = np.median(values, axis=0)
            spread = np.diag(np.median(sigmas, axis=0) ** 2 + values.var(axis=0))
        out.append(
            Spread(effect, len(cases), _prevalence(len(cases), len(vehicles)), names, location, spread)
        )
    return sorted(out, key=lambda spread: -spread.vehicles)


def _prevalence(having: int, of: int) -> tuple[float, float, float]:
    """Return the share that has something, by Jeffreys' rule: median and 95 % interval."""
    from scipy.special import betaincinv

    middle, low, high = betaincinv(having + 0.5, of - having + 0.5, [0.5, 0.025, 0.975]).tolist()
    return middle, low, high


def _spread(spread: Spread) -> dict[str, object]:
    middle, low, high = spread.prevalence
    return {
        "effect": spread.effect,
        "vehicles": spread.vehicles,
        "prevalence": middle,
        "prevalence_ci95": [low, high],
        "parameters": list(spread.names),
        "location": spread.location.tolist(),
        "spread": spread.spread.tolist(),
    }


def _drawn(spread: Spread, rng: np.random.Generator) -> str:
    from mavcompass.simulation.effects import Setting, get, spell

    far = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM))
    values = rng.multivariate_normal(np.zeros(len(spread.names)), spread.spread, method="eigh")
    drawn = dict(zip(spread.names, (spread.location + far * values).tolist(), strict=True))
    effect = get(spread.effect)
    inside = {
        p.name: float(np.clip(drawn[p.name], p.low, p.high)) for p in effect.parameters if p.name in drawn
    }
    return spell(Setting.of(effect, inside))


def write_distribution(distribution: Distribution, path: Path, presets: int = 0) -> list[Path]:
    """Write the document, and presets of our simulator drawn from it beside it; return all that was written.

    Raises UsageError where a file cannot be written.
    """
    from mavcompass.simulation.effects.registry import PRESET_SCHEMA

    documents: dict[Path, dict[str, object]] = {path: distribution.to_json()}
    rng = np.random.default_rng(1)
    for number in range(presets):
        file = path.with_name(f"{path.stem}.{number + 1:03d}.preset.json")
        effects = distribution.preset(rng)
        documents[file] = {"schema": PRESET_SCHEMA, "source": path.name, "effects": effects}
    for file, document in documents.items():
        write_text(file, json.dumps(document, indent=1) + "\n", "The distribution")
    return list(documents)
