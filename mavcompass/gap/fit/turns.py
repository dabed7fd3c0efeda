"""A compass in another orientation: turns by right angles, which no derivative leads to."""

from __future__ import annotations

from collections.abc import Sequence

from mavcompass.gap.fit.candidates import misfit_of
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay import yaw_starts

_LIKELY_YAWS = 2


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
            # One step is enough to see that a compass is not mounted so.
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
