"""What is true of a case of the blind trial, and which generator made it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Generator = Literal["bench", "vehicles", "another"]
Tier = Literal["none", "single", "pair", "withheld", "outside"]
GENERATORS: tuple[Generator, ...] = get_args(Generator)
TIERS: tuple[Tier, ...] = get_args(Tier)
SHARES: dict[Generator, dict[Tier, float]] = {
    "bench": {"none": 0.35, "single": 0.35, "pair": 0.15, "withheld": 0.15},
    "vehicles": {"none": 0.3, "single": 0.3, "pair": 0.15, "withheld": 0.1, "outside": 0.15},
    "another": {"none": 0.3, "single": 0.5, "pair": 0.2},
}


@dataclass(frozen=True, slots=True)
class Label:
    """Hold what is true of a case: tier, motion, the effects as `NAME:param=value,...`, their size in sigmas.

    The size is nan where it is only known beside the diagnosis's own noise (vehicles), until it is scored.
    """

    tier: Tier
    motion: str
    seed: int
    effects: tuple[str, ...]
    size_sigma: float = math.nan
    generator: Generator = "bench"

    @property
    def ids(self) -> tuple[str, ...]:
        """Return the names of the effects, sorted."""
        return tuple(sorted(text.partition(":")[0] for text in self.effects))
