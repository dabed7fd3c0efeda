"""Weigh fits of sets of effects against each other: is it needed, and which is it.

Two questions have two criteria. *How many* effects: one more is taken only where the whitened sum of squares
falls by more than chance allows once in 50 000 (chi-squared tail, corrected for the moments of change and
frequencies that were tried), and where the noise is not exact, by as much again as blocks contradict each
other. *Which*: sets of equal size compete by EBIC, SSE + k ln n + 2 m ln C (Chen and Chen, Biometrika 95,
2008), and the weights exp(-EBIC / 2) tell how sure that is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.fit.candidates import Candidate, Candidates
from mavcompass.gap.fit.chance import least_alone, least_growth
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem

_CATALOGUE_SIZE = 40
_BLOCK_S, _MOST_BLOCKS = 5.0, 30


class Criteria:
    """Weigh fits of one problem.

    `exact` says that the noise is known in detail; otherwise gains are held against how far blocks contradict
    each other. `temper` is by how much errors that last for seconds make sums of squares larger than they
    should be.
    """

    def __init__(self, problem: Problem, exact: bool = True) -> None:
        self.exact = exact
        self.temper = 1.0
        self._problem = problem
        self._log_n = math.log(max(problem.count, 2))
        self._log_c = math.log(_CATALOGUE_SIZE)
        # By what a fit has more than another one, and by the fit.
        self._contradictions: dict[tuple[frozenset[str], frozenset[str], float], float] = {}

    def score(self, fit: Fit) -> float:
        """Return the EBIC of a fit.

        Errors that last for seconds are the readings': what is known of vehicle and place keeps its weight.
        """
        strain = self._problem.strain(fit)
        return (fit.sse - strain) / self.temper + strain + self.cost(fit.dimension, len(fit.terms))

    def cost(self, dimension: int, effects: int = 1) -> float:
        """Return EBIC's penalty for so many parameters and effects."""
        return dimension * self._log_n + 2.0 * effects * self._log_c

    def grows(self, smaller: Fit, larger: Fit) -> bool:
        """Tell whether the larger set is needed."""
        least, gain = least_growth(smaller, larger, self._problem.count), smaller.sse - larger.sse
        if gain <= least or self.exact:
            return gain > least
        eased = self._problem.strain(smaller) - self._problem.strain(larger)
        return (gain - eased) / self.contradiction(smaller, larger) + eased > least

    def least(self, candidates: Candidates, chosen: tuple[Candidate, ...]) -> float:
        """Return the least gain of the member of a set that needs least."""
        least = math.inf
        for candidate in chosen:
            gain = least_alone(candidate.term, candidate.dimension, self._problem.count)
            if not self.exact:
                gain *= candidates.contradiction(chosen, [candidate])
            least = min(least, gain)
        return least

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
