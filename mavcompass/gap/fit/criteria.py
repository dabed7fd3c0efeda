"""Weigh fits of sets of effects against each other, as the posterior does (`selection/posterior`).

What a set costs is (1) there: its parameters and effects have prices that were learnt, and what readings say
counts by how far blocks of the recording contradict each other. One more effect is taken where that makes a
set cheaper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.fit.candidates import Candidates
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.tables import Kind, tables

_BLOCK_S, _MOST_BLOCKS = 5.0, 30


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
