"""Search the set of effects that explains a gap: beam search under a penalised likelihood.

Two questions have two criteria. *How many* effects: one more is taken only where the whitened sum of
squares falls by more than chance allows once in 50 000 (chi-squared tail, corrected for the moments of
change and frequencies that were tried). *Which*: sets of equal size compete by EBIC,
SSE + k ln n + 2 m ln C, and the weights exp(-EBIC / 2) tell how sure that is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from mavcompass.gap.guess import Guesser, Start
from mavcompass.gap.hypothesis import Fit, active_dimension, make_term
from mavcompass.gap.model import Problem
from mavcompass.simulation.effects.effect import MOMENTS, Effect

MOST_EFFECTS = 4
CHANCE = 2.0e-5
_BEAM = 3
_CATALOGUE_SIZE = 39
_REFINED = 7
_REFINED_LATER = 4
_SHORT = 2
_NEAR = 60.0
_HOPEFUL = 0.85
# Twice the gain that a useless parameter has on average.
_PRUNING = 2.0
_SEARCHED = MOMENTS | {"frequency_hz", "threshold", "source", "orientation"}


@lru_cache(maxsize=1024)
def least_gain(dimension: int, trials: int = 1) -> float:
    """Return the fall of the sum of squares that chance reaches with probability CHANCE.

    `trials` is how many places (moments, frequencies, thresholds) were tried for it.
    """
    from scipy.special import chdtri

    return float(chdtri(max(dimension, 1), CHANCE / max(trials, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Hold the result of a search.

    Attributes:
        null: the fit without effects; best: the fit of the best set (perhaps the null).
        explored: every fitted set by its ids; scores: their EBIC.
        weights: of the sets as large as the best one, sorted, those above 1 %.
    """

    null: Fit
    best: Fit
    explored: dict[frozenset[str], Fit]
    weights: tuple[tuple[frozenset[str], float], ...]


class Search:
    """Search sets of effects on one problem.

    `worthwhile` tells whether what a fit leaves could still hold an effect that may be named; the search
    goes on only then.
    """

    def __init__(
        self,
        problem: Problem,
        effects: Iterable[Effect],
        worthwhile: Callable[[Fit], bool] = lambda fit: True,
    ) -> None:
        self.problem = problem
        self.worthwhile = worthwhile
        signals = problem.replay.signals
        self.terms = [
            term
            for effect in effects
            if effect.kind in ("mean", "discrete") and (term := make_term(effect, signals)).dimension >= 0
        ]
        self.guesser = Guesser(problem, self.terms)
        self._log_n = math.log(max(problem.count, 2))
        self._log_c = math.log(_CATALOGUE_SIZE)
        self.explored: dict[frozenset[str], Fit] = {}

    def on(self, problem: Problem) -> Search:
        """Return a search of the same terms on other rows or under another noise, nothing explored yet."""
        other = Search(problem, (), self.worthwhile)
        other.terms, other.guesser = self.terms, Guesser(problem, self.terms)
        return other

    def score(self, fit: Fit) -> float:
        """Return the EBIC of a fit."""
        return fit.sse + self.cost(fit.dimension, len(fit.terms))

    def cost(self, dimension: int, effects: int = 1) -> float:
        """Return EBIC's penalty for so many parameters and effects."""
        return dimension * self._log_n + 2.0 * effects * self._log_c

    def run(self, most: int = MOST_EFFECTS) -> Found:
        """Search up to `most` effects."""
        null = self.problem.null()
        self.explored[frozenset()] = null
        best, beam = null, [null]
        for size in range(1, most + 1):
            if size > 1 and not self.worthwhile(best):
                break
            children = self._children(beam)
            if not children:
                break
            leader = children[0]
            if not self.grows(best, leader):
                if not best.terms:
                    self._listed(null, self.guesser.starts(null))
                break
            if size > 1:
                leader = self._swapped(leader)
            best = leader
            beam = sorted({leader.ids: leader, **{c.ids: c for c in children}}.values(), key=self.score)
            beam = beam[:_BEAM]
        best = self.polished(best)
        self.explored[best.ids] = best
        return Found(null, best, self.explored, self._weights(best))

    def nearest(self, most: int) -> Fit:
        """Return the fit that comes nearest with up to `most` effects, needed or not.

        On noiseless readings its sum of squares is the squared distance to all that these effects can make.
        """
        best = self.problem.null()
        beam = [best]
        for _ in range(most):
            fits: dict[frozenset[str], Fit] = {}
            for parent in beam:
                starts = sorted(self.guesser.starts(parent), key=lambda s: s.expected)[:_REFINED]
                for start in starts:
                    fit = self._extended(parent, start)
                    fits[fit.ids] = min(fit, fits.get(fit.ids, fit), key=lambda f: f.sse)
            if not fits:
                break
            beam = sorted(fits.values(), key=lambda f: f.sse)[:2]
            best = min(best, beam[0], key=lambda f: f.sse)
        return self.polished(best) if best.terms else best

    def grows(self, smaller: Fit, larger: Fit) -> bool:
        """Tell whether the larger set is needed."""
        rows = self.problem.count
        extra = max(_linear_dimension(larger) - _linear_dimension(smaller), 1)
        trials = max(_log_trials(larger, rows) - _log_trials(smaller, rows), 0.0)
        return smaller.sse - larger.sse > least_gain(extra, round(math.exp(trials)))

    def _weights(self, best: Fit) -> tuple[tuple[frozenset[str], float], ...]:
        if best.terms:
            rivals = {i: self.score(f) for i, f in self.explored.items() if len(i) == len(best.terms)}
        else:
            # Nothing is named; what it would most likely be is weighed by Akaike's criterion.
            rivals = {
                i: f.sse + 2.0 * f.dimension + self.cost(0, len(i))
                for i, f in self.explored.items()
                if len(i) <= 1
            }
        lowest = min(rivals.values())
        raw = {ids: math.exp(-0.5 * min(score - lowest, 1400.0)) for ids, score in rivals.items()}
        total = sum(raw.values())
        ranked = sorted(((ids, w / total) for ids, w in raw.items()), key=lambda item: -item[1])
        return tuple(item for item in ranked if item[1] > 0.01)

    def _children(self, beam: Sequence[Fit]) -> list[Fit]:
        children: dict[frozenset[str], Fit] = {}
        for place, parent in enumerate(beam):
            starts = self.guesser.starts(parent)
            hopeful = place > 0 or self._hopeful(parent, starts)
            if not hopeful and parent.terms:
                # What the best parent cannot use, a worse one can only use to become the best's equal.
                return []
            if not hopeful:
                self._listed(parent, starts)
                return []
            for fit in self._refined(parent, starts[: _REFINED if not parent.terms else _REFINED_LATER]):
                if fit.ids not in children or fit.sse < children[fit.ids].sse:
                    children[fit.ids] = fit
        self._remember(children.values())
        return sorted(children.values(), key=self.score)

    def _remember(self, fits: Iterable[Fit]) -> None:
        for fit in fits:
            if fit.ids not in self.explored or fit.sse < self.explored[fit.ids].sse:
                self.explored[fit.ids] = fit

    def _listed(self, null: Fit, starts: Sequence[Start]) -> None:
        """Try what a gap that is not named would most likely be: weighed and chosen by Akaike's criterion."""
        likely = sorted(starts, key=lambda s: s.expected + 2.0 * s.term.dimension)
        self._remember(self._refined(null, likely[:_REFINED]))

    def _refined(self, parent: Fit, starts: Sequence[Start]) -> list[Fit]:
        """Fit a few steps each; only those still near the best are fitted to the end."""
        fits = [self._extended(parent, start, _SHORT) for start in starts]
        near = min(self.score(f) for f in fits) + _NEAR if fits else 0.0
        return [self.problem.refit(f) if self.score(f) < near else f for f in fits]

    def _hopeful(self, parent: Fit, starts: Sequence[Start]) -> bool:
        return any(parent.sse - s.expected > _HOPEFUL * least_gain(s.term.dimension) for s in starts)

    def _extended(self, parent: Fit, start: Start, iterations: int = 8) -> Fit:
        return self.problem.fit(
            (*parent.terms, start.term),
            (*parent.thetas, start.theta),
            start.nuisances or parent.nuisance_thetas,
            iterations,
        )

    def _swapped(self, fit: Fit) -> Fit:
        """Replace each member by whatever serves better beside the others."""
        for _ in range(2):
            before = self.score(fit)
            for out in sorted(fit.ids):
                rest = self.without(fit, out)
                for start in self.guesser.starts(rest)[:3]:
                    rival = self._extended(rest, start)
                    if rival.ids not in self.explored or rival.sse < self.explored[rival.ids].sse:
                        self.explored[rival.ids] = rival
                    if self.score(rival) < self.score(fit) - 1e-6:
                        fit = rival
                        break
                if out not in fit.ids:
                    break
            if self.score(fit) >= before - 1e-6:
                break
        return fit

    def without(self, fit: Fit, effect_id: str) -> Fit:
        """Return the fit of the same set without one effect."""
        keep = [i for i, t in enumerate(fit.terms) if t.effect.id != effect_id]
        terms = [fit.terms[i] for i in keep]
        refitted = self.problem.fit(terms, [fit.thetas[i] for i in keep], fit.nuisance_thetas)
        known = self.explored.get(refitted.ids)
        if known is not None:
            # It may have been fitted a few steps only, or from a better start.
            known = self.problem.refit(known)
            refitted = min(refitted, known, key=lambda f: f.sse)
        self.explored[refitted.ids] = refitted
        return refitted

    def polished(self, fit: Fit) -> Fit:
        """Fit to convergence; look again for moments, places and frequencies beside the other effects."""
        if not fit.terms:
            return fit
        best = self.problem.refit(fit)
        for i, term in enumerate(best.terms):
            if term.effect.starts is None:
                continue
            rest = best.without(i)
            for start in term.effect.starts(self.guesser.misfit(rest)):
                terms = (*rest.terms, term)
                trial = self.problem.fit(terms, (*rest.thetas, start), best.nuisance_thetas)
                if self.score(trial) < self.score(best) - 1e-6:
                    best = _in_order(trial, best)
        return self._settled(best)

    def _settled(self, fit: Fit) -> Fit:
        """Take back moments of change that the data do not need: they were sought at many places."""
        for i, term in enumerate(fit.terms):
            for j, parameter in enumerate(term.effect.parameters):
                if parameter.name not in term.effect.optional:
                    continue
                if not parameter.low < fit.thetas[i][j] < parameter.high:
                    continue
                never = fit.thetas[i].copy()
                never[j] = term.effect.neutral()[j]
                thetas = (*fit.thetas[:i], never, *fit.thetas[i + 1 :])
                always = self.problem.fit(fit.terms, thetas, fit.nuisance_thetas)
                if not self.grows(always, fit):
                    fit = always
        return fit

    def pruned(self, fit: Fit) -> Fit:
        """Hold parameters at zero that the data do not need beside the others, one after another.

        Of several that could go, that one goes which leaves the smallest parameters in natural sizes.
        """
        if len(fit.terms) < 2:
            return fit
        while True:
            options = []
            for i, term in enumerate(fit.terms):
                if not term.effect.affine or term.dimension < 2:
                    continue
                for j in np.flatnonzero(term.free):
                    free = term.free.copy()
                    free[j] = False
                    theta = fit.thetas[i].copy()
                    theta[j] = 0.0
                    terms = (*fit.terms[:i], replace(term, free=free), *fit.terms[i + 1 :])
                    thetas = (*fit.thetas[:i], theta, *fit.thetas[i + 1 :])
                    trial = self.problem.fit(terms, thetas, fit.nuisance_thetas, _SHORT)
                    if trial.sse < fit.sse + _PRUNING:
                        options.append(trial)
            if not options:
                return fit
            fit = min(options, key=_natural_size)


def _natural_size(fit: Fit) -> float:
    return sum(
        float(np.sum((x / np.maximum(t.effect.scale, 1e-12))[t.free] ** 2))
        for t, x in zip(fit.terms, fit.thetas, strict=True)
        if t.effect.affine
    )


def _searched(fit: Fit) -> list[str]:
    """List the parameters of a fit that were searched over a range, not fitted from nothing."""
    return [
        p.name
        for term, theta in zip(fit.terms, fit.thetas, strict=True)
        for p, v in zip(term.effect.parameters, theta, strict=True)
        if p.name in _SEARCHED and not (p.name in term.effect.optional and not p.low < v < p.high)
    ]


def _linear_dimension(fit: Fit) -> int:
    total = sum(active_dimension(t, x) for t, x in zip(fit.terms, fit.thetas, strict=True))
    return total - len(_searched(fit))


def _log_trials(fit: Fit, rows: int) -> float:
    """Return the logarithm of how many independent places were tried.

    Neighbouring moments are hardly independent: about a third of the rows counts.
    """
    each = {**dict.fromkeys(MOMENTS, rows / 3.0), "frequency_hz": 2.0 * rows}
    return sum(math.log(max(each.get(name, 24.0), 1.0)) for name in _searched(fit))


def _in_order(fit: Fit, like: Fit) -> Fit:
    """Put the terms of a fit in the order of another fit of the same set."""
    place = {t.effect.id: i for i, t in enumerate(fit.terms)}
    order = [place[t.effect.id] for t in like.terms]
    return Fit(
        tuple(fit.terms[i] for i in order),
        tuple(fit.thetas[i] for i in order),
        fit.nuisance_thetas,
        fit.sse,
        fit.covariance,
    )
