"""Weigh sets of effects as the posterior does (`selection/posterior`); the beam over sets.

What a set costs is (1) there: its parameters and effects have prices that were learnt, and what readings say
counts by how far blocks of the recording contradict each other. One more effect is taken where that makes a
set cheaper. The likeliest sets of each size come from normal equations, without a fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.fit.candidates import Candidate, Candidates
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.tables import Kind, tables

_BLOCK_S, _MOST_BLOCKS = 5.0, 30
_BEAM = 5
# Sets that come so near to the best one of their size are fitted through the simulation, so many at most.
_NEAR, _FITTED = 40.0, 4


class Criteria:
    """Weigh fits of one problem.

    `kind` tells how the recording is known: where that is not in detail, gains are held against how far
    blocks contradict each other. `temper` is by how much errors that last for seconds make sums of squares
    larger than they should be.
    """

    def __init__(self, problem: Problem, kind: Kind = "exact") -> None:
        self.kind: Kind = kind
        self.exact = kind in ("exact", "reference")
        self.temper = 1.0
        self._problem = problem
        # By what a fit has more than another one, and by the fit.
        self._contradictions: dict[tuple[frozenset[str], frozenset[str], float], float] = {}

    def score(self, fit: Fit, temper: float | None = None) -> float:
        """Return what a fit costs, under another temper perhaps.

        Errors that last for seconds are the readings': what is known of vehicle and place keeps its weight.
        """
        strain = self._problem.strain(fit)
        spread = self.temper if temper is None else temper
        return (fit.sse - strain) / spread + strain + self.cost(fit.dimension, len(fit.terms))

    def cost(self, dimension: int, effects: int) -> float:
        """Return the price of so many parameters and effects."""
        return tables().penalty[self.kind].of(dimension, effects, self._problem.count)

    def grows(self, smaller: Fit, larger: Fit) -> bool:
        """Tell whether the larger set is needed."""
        effects = len(larger.terms) - len(smaller.terms)
        least = self.cost(max(larger.dimension - smaller.dimension, 1), effects)
        gain = smaller.sse - larger.sse
        if gain <= least or self.exact:
            return gain > least
        eased = self._problem.strain(smaller) - self._problem.strain(larger)
        return (gain - eased) / self.contradiction(smaller, larger) + eased > least

    def contradiction(self, smaller: Fit, larger: Fit) -> float:
        """Return by how much blocks contradict each other about what a larger set has more, 1 where they do
        not."""
        more = larger.ids - smaller.ids
        if not more:
            return 1.0
        key = (more, larger.ids, larger.sse)
        if key not in self._contradictions:
            candidates = Candidates(self._problem, (), larger, self.blocks())
            members = candidates.list
            of = [c for c in members if c.term.effect.id in more]
            self._contradictions[key] = candidates.contradiction(members, of) if of else 1.0
        return self._contradictions[key]

    def blocks(self) -> NDArray[np.int64]:
        """Label the rows of a replay (N,) by what may err together, thirty blocks at most."""
        time = self._problem.replay.time_s
        length = max(_BLOCK_S, float(time[-1] - time[0]) / _MOST_BLOCKS)
        return np.floor((time - time[0]) / length).astype(np.int64)


def likeliest_sets(
    candidates: Candidates, criteria: Criteria, most: int
) -> dict[int, list[tuple[Candidate, ...]]]:
    """Return the likeliest sets of each size up to `most`, the best first."""
    every = candidates.list
    if not every:
        return {}
    effect, dimension = [c.term.effect.id for c in every], [c.dimension for c in every]
    scores: dict[tuple[int, ...], float] = {}

    def weigh(sets: Iterable[tuple[int, ...]]) -> None:
        new = [members for members in sets if members not in scores]
        left = candidates.expected([[every[i] for i in members] for members in new])
        for members, sse in zip(new, left.tolist(), strict=True):
            parameters = sum(dimension[i] for i in members)
            scores[members] = sse / criteria.temper + criteria.cost(parameters, len(members))

    def grown(parent: tuple[int, ...]) -> set[tuple[int, ...]]:
        held = {effect[m] for m in parent}
        return {tuple(sorted((*parent, i))) for i in range(len(every)) if effect[i] not in held}

    out: dict[int, list[tuple[Candidate, ...]]] = {}
    beam: list[tuple[int, ...]] = [()]
    lowest = math.inf
    for size in range(1, most + 1):
        sets = {members for parent in beam for members in grown(parent)}
        if not sets:
            break
        weigh(sets)
        if size > 1:
            best = min(sets, key=scores.__getitem__)
            sets |= {other for gone in best for other in grown(tuple(m for m in best if m != gone))}
            weigh(sets)
        ranked = sorted(sets, key=scores.__getitem__)
        beam = ranked[: _BEAM if size > 1 else 2 * _BEAM]
        smaller, lowest = lowest, scores[ranked[0]]
        seen: dict[frozenset[str], tuple[int, ...]] = {}
        for members in ranked[: 8 * _FITTED]:
            seen.setdefault(frozenset(effect[i] for i in members), members)
        near = [m for m in seen.values() if scores[m] < lowest + _NEAR]
        out[size] = [tuple(every[i] for i in members) for members in near[:_FITTED]]
        if lowest > smaller + criteria.cost(2, 0):
            break
    return out
