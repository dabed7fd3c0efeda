"""How much chance gains."""

from __future__ import annotations

from functools import lru_cache

from mavcompass.chance import chi_square_of

CHANCE = 2.0e-5


@lru_cache(maxsize=1024)
def least_gain(dimension: int, trials: int = 1) -> float:
    """Return the fall of the sum of squares that chance reaches with probability CHANCE.

    `trials` is how many places (moments, frequencies, thresholds) were tried for it.
    """
    return chi_square_of(CHANCE / max(trials, 1), max(dimension, 1))
