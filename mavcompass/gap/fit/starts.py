"""Where fits begin that no derivative leads to, and how they end: polished, and without what is not needed.

What is bent by a gap hides what bends it; what makes readings late is hidden by the age of telemetry; a
compass in another orientation is turned by right angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.candidates import misfit_of
from mavcompass.gap.fit.criteria import Criteria
from mavcompass.gap.fit.hypothesis import Fit, Term, least_gain
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, TELEMETRY_AGE, Nuisance, yaw_starts
from mavcompass.simulation.effects.effect import LAG, MOMENTS, NEVER_S

# So many steps tell whether a fit is worth going on with.
FEW_STEPS = 3
# An age of telemetry that is bent by so many natural sizes may hide such an effect.
_BENT = 1.0
_LIKELY_YAWS = 2
# A start so near, in natural sizes, leads to where a fit is.
_SAME = 0.1
# Twice the gain that a useless parameter has on average.
_PRUNING = 2.0


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


def beside_known_age(
    problem: Problem, terms: Sequence[Term], null: Fit, nuisance_thetas: Sequence[FloatArray]
) -> list[Fit]:
    """Fit each effect that makes readings late, from where their age is as it is known.

    Without effects (`null`) the age is bent instead, and beside a bent age no derivative leads back. The
    other nuisances begin where `nuisance_thetas` has them.
    """
    age = next((i for i, n in enumerate(problem.nuisances) if n.effect.id == TELEMETRY_AGE), None)
    if age is None:
        return []
    nuisance = problem.nuisances[age]
    late_s = float(null.nuisance_thetas[age][0] - nuisance.mean[0])
    if late_s < _BENT * float(nuisance.effect.scale[0]):
        return []
    start = [*nuisance_thetas[:age], nuisance.mean.copy(), *nuisance_thetas[age + 1 :]]
    late = [term for term in terms if term.effect.delays.any()]
    return [problem.fit((term,), (_as_late(term, late_s),), start, FEW_STEPS) for term in late]


def in_place_of_each_other(problem: Problem, terms: Sequence[Term], fit: Fit) -> list[Fit]:
    """Fit every other effect that makes readings late in the place of one that a fit has.

    What changes at a moment is seen when a late reading comes: the moment moves with the effect.
    """
    out = []
    for place, term in enumerate(fit.terms):
        if not term.effect.delays.any():
            continue
        late_s = float(fit.thetas[place][term.effect.delays].mean())
        rest = fit.without(place)
        for other in (t for t in terms if t.effect.delays.any() and t.effect.id not in fit.ids):
            later_s = late_s * ((LAG in term.effect.names) - (LAG in other.effect.names))
            members = zip(rest.terms, rest.thetas, strict=True)
            thetas = (*(_moved(*member, later_s) for member in members), _as_late(other, late_s))
            out.append(problem.fit((*rest.terms, other), thetas, fit.nuisance_thetas, FEW_STEPS))
    return out


def _changes(term: Term, theta: FloatArray) -> NDArray[np.bool_]:
    """Tell which parameters are moments of change that come, (k,)."""
    return np.array([p.name in MOMENTS for p in term.effect.parameters]) & (np.abs(theta) < NEVER_S)


def _as_late(term: Term, late_s: float) -> FloatArray:
    """Return the parameters with which an effect makes readings so late."""
    return np.clip(np.where(term.effect.delays, late_s, term.effect.neutral()), term.lower, term.upper)


def _moved(term: Term, theta: FloatArray, by_s: float) -> FloatArray:
    """Move the moments of change of an effect, but those that never come."""
    moments = _changes(term, theta)
    return np.where(moments, theta + by_s, theta)


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


def turn_alone(problem: Problem, fit: Fit) -> Fit:
    """Fit the turn of a set by itself."""
    if len(fit.terms) == 1:
        return fit
    place = next(i for i, term in enumerate(fit.terms) if term.effect.kind == "discrete")
    return problem.fit((fit.terms[place],), (fit.thetas[place],), fit.nuisance_thetas)


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


def pruned(problem: Problem, fit: Fit) -> Fit:
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
                trial = problem.fit(terms, thetas, fit.nuisance_thetas, FEW_STEPS)
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
