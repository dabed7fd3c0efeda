"""Polish a set that was found: fit it to its end, look for where its effects begin, take moments back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.gap.fit.candidates import misfit_of
from mavcompass.gap.fit.criteria import Criteria
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.simulation.effects.effect import MOMENTS

_STEPS = 3
# A start so near, in natural sizes, leads to where a fit is.
_SAME = 0.1


def polished(problem: Problem, criteria: Criteria, fit: Fit, moments: bool = False) -> Fit:
    """Fit to convergence; look again for moments, places and frequencies beside the other effects, or for
    `moments` only."""
    if not fit.terms:
        return fit
    best = problem.refit(fit)
    for i, term in enumerate(best.terms):
        if term.effect.starts is None or term.effect.kind == "discrete":
            continue
        if moments and MOMENTS.isdisjoint(term.effect.names):
            continue
        rest = best.without(i)
        for start in term.effect.starts(misfit_of(problem, problem.signals(rest))):
            if (np.abs(start - best.thetas[i]) <= _SAME * term.effect.scale).all():
                continue
            terms = (*rest.terms, term)
            trial = problem.fit(terms, (*rest.thetas, start), best.nuisance_thetas, _STEPS)
            if criteria.score(trial) < criteria.score(best) - 1e-6:
                best = _in_order(problem.refit(trial), best)
    return best


def _in_order(fit: Fit, like: Fit) -> Fit:
    """Put the terms of a fit in the order of another fit of the same set."""
    place = {t.effect.id: i for i, t in enumerate(fit.terms)}
    order = [place[t.effect.id] for t in like.terms]
    terms, thetas = tuple(fit.terms[i] for i in order), tuple(fit.thetas[i] for i in order)
    return replace(fit, terms=terms, thetas=thetas)
