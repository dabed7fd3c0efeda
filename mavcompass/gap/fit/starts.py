"""Fits from starts that no derivative leads to.

What makes readings late is hidden by the age of telemetry; a compass in another orientation is turned by
right angles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.candidates import misfit_of
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay import TELEMETRY_AGE, yaw_starts
from mavcompass.simulation.effects.effect import LAG, MOMENTS, NEVER_S

# An age of telemetry that is bent by so many natural sizes may hide such an effect.
_BENT = 1.0
_ITERATIONS = 3
_LIKELY_YAWS = 2


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
    return [problem.fit((term,), (_as_late(term, late_s),), start, _ITERATIONS) for term in late]


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
            out.append(problem.fit((*rest.terms, other), thetas, fit.nuisance_thetas, _ITERATIONS))
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
                fits = [problem.fit(together, f.thetas, f.nuisance_thetas, _ITERATIONS) for f in fits[:1]]
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
