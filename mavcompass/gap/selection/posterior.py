"""The criterion: one posterior over the sets of effects that a search explored.

What a set S costs is minus twice the logarithm of its evidence and its prior, up to a constant:

    c(S) = (SSE_S - m_S) / T + m_S + a d_S ln n + b k_S                                              (1)

SSE is the whitened sum of squares of n rows and m the part of it by which what is known of vehicle and
place is strained (its Mahalanobis distance from the prior); T >= 1 is the overdispersion, by which blocks
of the recording contradict each other about what the fullest set has more than none; d parameters cost
Schwarz's a ln n each (Annals of Statistics 6, 1978), k effects their prior odds, b. Both are learnt
(`params/gap`).

What a search found, and what the criterion chose of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Found, Search
from mavcompass.gap.selection.split import Split

# So many of the cheapest sets are fitted to the end, but none that costs so much more than the cheapest.
_REFITTED, _HOPELESS = 8, 100.0
# Predictions that differ by less than three sigmas, or by this share of what is explained, are the same.
_SAME, _SAME_SHARE = 9.0, 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Hold a set of effects as fitted, what it costs (1), and whether it is the best one in other words.

    `apart` is the whitened squared distance between what it predicts and what the best one does.
    """

    fit: Fit
    cost: float
    apart: float
    strain: float


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Hold the explored sets, the cheapest first, the empty one among them; `overdispersion` is T of (1)."""

    explanations: tuple[Explanation, ...]
    overdispersion: float

    @property
    def best(self) -> Explanation:
        """Return the cheapest set."""
        return self.explanations[0]

    @property
    def nothing(self) -> Explanation:
        """Return the empty set."""
        return next(e for e in self.explanations if not e.fit.terms)

    @property
    def gain(self) -> float:
        """Return by how much the best set is cheaper than none."""
        return self.nothing.cost - self.best.cost

    @property
    def lead(self) -> float:
        """Return by how much the best set is cheaper than any that is not the same in more words."""
        others = [e.cost for e in self.explanations[1:] if not self.restates(e)]
        return min(others, default=math.inf) - self.best.cost

    @property
    def rivals(self) -> list[Explanation]:
        """List the other sets, but those that are the same in more words."""
        return [e for e in self.explanations[1:] if e.fit.terms and not self.restates(e)]

    def without(self, effect_id: str) -> float:
        """Return by how many sigmas the best set without an effect falls short of the best one, or 0."""
        others = [e.cost for e in self.explanations if effect_id not in e.fit.ids]
        return math.sqrt(max(min(others, default=math.inf) - self.best.cost, 0.0))

    def restates(self, other: Explanation) -> bool:
        """Tell whether a set is observationally equivalent to the best one, with more parameters."""
        best, none = self.best, self.nothing
        most = max(_SAME * self.overdispersion, _SAME_SHARE * (none.fit.sse - best.fit.sse))
        return other.apart < most and other.fit.dimension > best.fit.dimension

    def weights(self, likely: float) -> tuple[tuple[frozenset[str], float], ...]:
        """Share a probability among the rivals of the best set, by (1)."""
        rivals = self.rivals
        if not rivals:
            return ()
        raw = np.exp(-0.5 * np.array([e.cost - rivals[0].cost for e in rivals]))
        shares = likely * raw / raw.sum()
        return tuple((e.fit.ids, float(share)) for e, share in zip(rivals, shares, strict=True))


def posterior_of(search: Search, found: Found) -> Posterior:
    """Weigh the explored sets of a search, the likeliest of them fitted to the end."""
    problem = search.problem
    explored = {frozenset(): problem.null(), **found.explored}
    fullest = min(explored.values(), key=lambda fit: fit.sse)
    spread = max(1.0, search.criteria.contradiction(found.null, fullest)) if fullest.terms else 1.0

    def cost(fit: Fit) -> float:
        return search.criteria.score(fit, spread)

    ranked = sorted(explored.values(), key=cost)
    for fit in ranked[:_REFITTED]:
        if fit.terms and cost(fit) < cost(ranked[0]) + _HOPELESS:
            explored[fit.ids] = problem.refit(fit)
    ranked = sorted(explored.values(), key=cost)
    here = problem.predict(ranked[0])
    explanations = []
    for place, fit in enumerate(ranked):
        near = place < _REFITTED or not fit.terms
        apart = float(np.sum(problem.shift(problem.predict(fit), here) ** 2)) if near else math.inf
        explanations.append(Explanation(fit, cost(fit), apart, problem.strain(fit)))
    return Posterior(tuple(explanations), spread)


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Hold the best set as fitted to the training rows of a split, and how it was found.

    `first` is the problem that the sets were explored and weighed on (a change inside a held-out block
    moves rows afterwards).
    """

    problem: Problem
    split: Split
    found: Found
    fit: Fit
    search: Search
    first: Problem
    posterior: Posterior
