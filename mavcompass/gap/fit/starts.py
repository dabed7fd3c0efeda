"""Where fits begin that no derivative leads to, and how they end.

What is bent by a gap hides what bends it; what makes readings late is hidden by the age of telemetry; a
compass in another orientation is turned by right angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.candidates import Criteria, misfit_of
from mavcompass.gap.fit.hypothesis import Fit, Term, least_gain
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, TELEMETRY_AGE, Nuisance, yaw_starts
from mavcompass.simulation.effects.effect import MOMENTS

# So many steps tell whether a fit is worth going on with.
FEW_STEPS = 3
_LIKELY_YAWS = 2
# A start so near, in natural sizes, leads to where a fit is.
_SAME = 0.1


def unbent(problem: Problem, fit: Fit, curves: bool = False) -> Fit:
    """Return nuisances to their prior where a gap has bent them far: what is wrong must show to be
    found. How the attitude wanders explains nothing away, but beside bent `curves` no derivative is
    good."""
    if fit.terms or not problem.nuisances:
        return fit
    straight = problem.straight(fit)

    def kept_of(n: Nuisance, x: FloatArray) -> FloatArray:
        if n.effect.id == REFERENCE_YAW:
            return _facing_as_known(n, x, curves)
        # How old readings are is another matter than the iron and the place that a gap may bend.
        aged = n.effect.id == TELEMETRY_AGE and _by_chance(n, x)
        return x if straight or aged else n.mean.copy()

    kept = tuple(kept_of(n, x) for n, x in zip(problem.nuisances, fit.nuisance_thetas, strict=True))
    same = all(np.array_equal(x, y) for x, y in zip(kept, fit.nuisance_thetas, strict=True))
    return fit if same else replace(fit, nuisance_thetas=kept)


def _facing_as_known(yaw: Nuisance, theta: FloatArray, curves: bool) -> FloatArray:
    """Return the yaw's constant to what is known of it where it was bent far, and the attitude's `curves`
    where they wandered farther than by chance."""
    off, out = theta - yaw.mean, theta.copy()
    if off[0] ** 2 * yaw.precision[0, 0] >= least_gain(1):
        out[0] = yaw.mean[0]
    if curves and off[1:] @ yaw.precision[1:, 1:] @ off[1:] >= least_gain(theta.size - 1):
        out[1:] = yaw.mean[1:]
    return out


def _by_chance(nuisance: Nuisance, theta: FloatArray) -> bool:
    """Tell whether a nuisance by itself lies no farther from what is known of it than by chance."""
    off = theta - nuisance.mean
    return float(off @ nuisance.precision @ off) < least_gain(theta.size)


def facing(problem: Problem, terms: Sequence[Term], beside: Fit, most_sse: float) -> list[Fit]:
    """Fit each likely orientation beside the effects of a fit, where it may leave less than `most_sse`."""
    out: list[Fit] = []
    for term in terms:
        if term.effect.kind != "discrete" or term.effect.starts is None:
            continue
        together = (*beside.terms, term)
        for guess in term.effect.starts(misfit_of(problem, problem.signals(beside))):
            thetas, starts = (*beside.thetas, guess), yaw_starts(problem.nuisances)
            fits = sorted((problem.fit(together, thetas, start, 1) for start in starts), key=lambda f: f.sse)
            if len(starts) > 1 and fits[0].sse >= most_sse:
                # Where the yaw may be anything, one of six is off by so much that it takes a few steps more.
                fits = [problem.fit(together, f.thetas, f.nuisance_thetas, FEW_STEPS) for f in fits[:1]]
            # Elsewhere one step is enough to see that a compass is not mounted so.
            likely = [fit for fit in fits[:_LIKELY_YAWS] if fit.sse < most_sse]
            if likely:
                out.append(min(map(problem.refit, likely), key=lambda f: f.sse))
    return out


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
            trial = problem.fit(terms, (*rest.thetas, start), best.nuisance_thetas, FEW_STEPS)
            if criteria.score(trial) < criteria.score(best) - 1e-6:
                best = _in_order(problem.refit(trial), best)
    return best


def _in_order(fit: Fit, like: Fit) -> Fit:
    """Put the terms of a fit in the order of another fit of the same set."""
    place = {t.effect.id: i for i, t in enumerate(fit.terms)}
    order = [place[t.effect.id] for t in like.terms]
    terms, thetas = tuple(fit.terms[i] for i in order), tuple(fit.thetas[i] for i in order)
    return replace(fit, terms=terms, thetas=thetas)
