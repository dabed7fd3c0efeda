"""The numbers of the diagnosis, as data: what decides, and what is usual before a recording says more.

What decides, `params/gap/criterion.json`, is made by `scripts/campaigns/learn_gap.py` from simulated
vehicles, healthy and not, by makers that share no code; the file says which, and with which seeds. What is
usual is in `params/gap/usual.toml`. Nothing in either is fitted on the recording in hand.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal, cast, get_args

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.installation.parts import params_path

SCHEMA = "mavcompass.gap-criterion/1"
# How a recording is known: beside a baseline that the simulation explains in detail, beside another one,
# alone with an independent attitude, or alone with its own.
Kind = Literal["exact", "baseline", "reference", "alone"]
KINDS: tuple[Kind, ...] = get_args(Kind)
# What the best set may be: all of the truth, a part of it, another of the explored sets, none of them.
Outcome = Literal["whole", "part", "other", "unknown"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)


@dataclass(frozen=True, slots=True)
class Penalty:
    """Hold what a parameter costs, in ln n, and an effect."""

    parameter: float
    effect: float

    def of(self, parameters: int, effects: int, rows: int) -> float:
        """Return what so many cost on so many rows."""
        return self.parameter * parameters * math.log(max(rows, 2)) + self.effect * effects


@dataclass(frozen=True, slots=True)
class Levels:
    """Hold all thresholds of decision: two false-alarm rates, and four limits of what is reported.

    Attributes:
        gain: how seldom healthy vehicles gain so much from any set; fit: how seldom they leave so much.
        sure: the probability from which a set is named.
        above: times the floor from which a figure is above it, less being the floor's own uncertainty.
        held: the share of what all known sets hold that the told ones do.
        coarsest_deg: the heading's floor from which on a recording tells nothing.
    """

    gain: float
    fit: float
    sure: float
    above: float
    held: float
    coarsest_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Healthy:
    """Hold what healthy vehicles show, `count` of them.

    Attributes:
        names: statistics of what is left; usual: by kind their medians, and how far 84th percentiles lie off.
        gains: the largest gains of the best set over none, sorted; scores: the largest of `score`, sorted.
    """

    count: int
    names: tuple[str, ...]
    usual: Mapping[Kind, tuple[FloatArray, FloatArray]]
    gains: FloatArray
    scores: FloatArray

    def score(self, kind: Kind, values: Mapping[str, float]) -> float:
        """Return how far what is left lies above healthy vehicles' in the statistic in which it does most."""
        centre, size = self.usual[kind]
        return float(np.max((np.array([values[name] for name in self.names]) - centre) / size))

    def p_of_gain(self, gain: float) -> float:
        """Return the conformal p value of a gain."""
        return _p_value(gain, self.gains, self.count)

    def p_of_fit(self, kind: Kind, values: Mapping[str, float]) -> float:
        """Return the conformal p value of what is left."""
        return _p_value(self.score(kind, values), self.scores, self.count)


@dataclass(frozen=True, slots=True, eq=False)
class ProbabilityMap:
    """Hold a logistic map from statistics to the probabilities of the outcomes.

    `centre` and `size` standardise the statistics `names` (K,); `weights` (1 + K, outcomes), the constants
    first.
    """

    names: tuple[str, ...]
    centre: FloatArray
    size: FloatArray
    weights: FloatArray

    def probabilities(self, values: Mapping[str, float]) -> dict[Outcome, float]:
        """Return how probable each outcome is."""
        x = (np.array([values[name] for name in self.names]) - self.centre) / self.size
        scores = np.concatenate([[1.0], x]) @ self.weights
        raw = np.exp(scores - scores.max())
        return dict(zip(OUTCOMES, (raw / raw.sum()).tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """Hold all of it."""

    penalty: Mapping[Kind, Penalty]
    levels: Levels
    healthy: Healthy
    map: ProbabilityMap


def _usual() -> SimpleNamespace:
    """Read `params/gap/usual.toml`, table by table; angles are in radians, their names as well."""

    def read(name: str, value: object) -> tuple[str, object]:
        radians = name.replace("_deg", "_rad")
        return radians, math.radians(cast(float, value)) if radians != name else value

    document = tomllib.loads(params_path("gap/usual.toml").read_text(encoding="utf-8"))
    return SimpleNamespace(
        **{
            table: SimpleNamespace(**dict(read(*one) for one in values.items()))
            for table, values in document.items()
        }
    )


# What is known before a recording says more: sensors, receivers, autopilots, places.
usual: Any = _usual()


@cache
def tables() -> Tables:
    """Read the tables."""
    return parsed(json.loads(params_path("gap/criterion.json").read_text(encoding="utf-8")))


def parsed(document: Mapping[str, object]) -> Tables:
    """Make tables of their document. Raises ValueError for another schema."""
    found = cast(Any, document)
    if found["schema"] != SCHEMA:
        raise ValueError(f"criterion.json is not {SCHEMA}")
    known = found["healthy"]
    usual = {kind: (np.array(one["centre"]), np.array(one["size"])) for kind, one in known["usual"].items()}
    healthy = Healthy(
        known["count"], tuple(known["names"]), usual, np.array(known["gains"]), np.array(known["scores"])
    )
    own = found["map"]
    return Tables(
        {kind: Penalty(**one) for kind, one in found["penalty"].items()},
        Levels(**found["levels"]),
        healthy,
        ProbabilityMap(
            tuple(own["names"]), np.array(own["centre"]), np.array(own["size"]), np.array(own["weights"])
        ),
    )


def _p_value(value: float, largest: FloatArray, count: int) -> float:
    """Return the share of a population of healthy vehicles, with this one among them, that lies no lower.

    Only the largest values are stored: below all of them the p value is at least their share (Vovk,
    Gammerman and Shafer, Algorithmic Learning in a Random World, 2005).
    """
    higher = int(np.sum(largest >= value)) if math.isfinite(value) else 0
    return (1 + higher) / (1 + count)
