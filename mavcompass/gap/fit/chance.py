"""How much one more effect must gain before chance is no explanation.

What is sought over a range (moments, frequencies, thresholds) has as many chances as there are places in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

from mavcompass.chance import chi_square_of
from mavcompass.gap.fit.hypothesis import Fit, Term, active_dimension
from mavcompass.simulation.effects.effect import FREQUENCY, MOMENTS, THRESHOLD, Parameter

CHANCE = 2.0e-5


def _is_sought(parameter: Parameter) -> bool:
    """Tell what is sought over a range from what is fitted from nothing."""
    whole = parameter.integer and not parameter.optional
    return whole or parameter.name in MOMENTS | {FREQUENCY, THRESHOLD}


@lru_cache(maxsize=1024)
def least_gain(dimension: int, trials: int = 1) -> float:
    """Return the fall of the sum of squares that chance reaches with probability CHANCE.

    `trials` is how many places (moments, frequencies, thresholds) were tried for it.
    """
    return chi_square_of(CHANCE / max(trials, 1), max(dimension, 1))


def least_growth(smaller: Fit, larger: Fit, rows: int) -> float:
    """Return what a larger set must gain over a smaller one on so many rows."""
    few, many = _sought(smaller), _sought(larger)
    extra = _dimension(larger) - len(many) - (_dimension(smaller) - len(few))
    trials = max(_log_trials(many, rows) - _log_trials(few, rows), 0.0)
    return least_gain(max(extra, 1), round(math.exp(trials)))


def least_alone(term: Term, dimension: int, rows: int) -> float:
    """Return what one effect of so many parameters must gain on so many rows."""
    names = [p.name for p in term.effect.parameters if _is_sought(p)]
    return least_gain(dimension, round(math.exp(_log_trials(names[:1], rows))))


def _dimension(fit: Fit) -> int:
    return sum(active_dimension(t, x) for t, x in zip(fit.terms, fit.thetas, strict=True))


def _sought(fit: Fit) -> list[str]:
    """List the parameters of a fit that were sought over a range, not fitted from nothing."""
    return [
        p.name
        for term, theta in zip(fit.terms, fit.thetas, strict=True)
        for p, v in zip(term.effect.parameters, theta, strict=True)
        if _is_sought(p) and not (p.optional and not p.low < v < p.high)
    ]


def _log_trials(names: Sequence[str], rows: int) -> float:
    """Return the logarithm of how many independent places were tried for some parameters.

    Neighbouring moments are hardly independent: about a third of the rows counts.
    """
    each = {**dict.fromkeys(MOMENTS, rows / 3.0), FREQUENCY: 2.0 * rows}
    return sum(math.log(max(each.get(name, 24.0), 1.0)) for name in names)
