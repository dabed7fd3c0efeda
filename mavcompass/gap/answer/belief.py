"""What a diagnosis believes of vehicle and place, as distributions from which others like it can be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.replay import IRON_MATRIX, IRON_OFFSET, WORLD_FIELD
from mavcompass.gap.result import Belief
from mavcompass.gap.selection import Identified

# Field, matrix, offset and motors: what every belief begins with.
_PLACES = {WORLD_FIELD.id: slice(0, 3), IRON_MATRIX: slice(3, 12), IRON_OFFSET: slice(12, 18)}
_COMMON = 18
_LEAST_WEIGHT = 0.02


def beliefs(
    identified: Identified, named: Fit, sets: Sequence[tuple[frozenset[str], float]]
) -> tuple[Belief, ...]:
    """Return the answer as a distribution; of several `sets` each by its weight."""
    problem = identified.problem
    chosen = [(1.0, named)]
    if sets:
        explored = {e.fit.ids: e.fit for e in identified.posterior.explanations} | {named.ids: named}
        chosen = [(weight, explored[ids]) for ids, weight in sets if weight >= _LEAST_WEIGHT] or chosen
    total = sum(weight for weight, _ in chosen)
    return tuple(_belief(problem, weight / total, fit) for weight, fit in chosen)


def _belief(problem: Problem, weight: float, fit: Fit) -> Belief:
    values = [np.zeros(_COMMON), *fit.thetas]
    starts = np.cumsum([0, *(v.size for v in values)])
    mean = np.concatenate(values)
    rows: list[int] = []  # of the mean, for each fitted parameter; -1 for those of other nuisances
    for nuisance, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True):
        place = _PLACES.get(nuisance.effect.id)
        if place is None:
            rows += [-1] * theta.size
            continue
        rows += range(place.start, place.start + theta.size)
        mean[place.start : place.start + theta.size] = theta
    for term, start in zip(fit.terms, starts[1:], strict=False):
        rows += (start + np.flatnonzero(term.free)).tolist()
    covariance = np.zeros((mean.size, mean.size))
    kept = np.flatnonzero(np.array(rows, dtype=np.int64) >= 0)
    places = np.array(rows, dtype=np.int64)[kept]
    covariance[np.ix_(places, places)] = problem.lasting_covariance(fit)[np.ix_(kept, kept)]
    from_usual = _from_no_load(mean.size, float(problem.replay.iron.load.mean()))
    return Belief(
        weight,
        tuple(term.effect.id for term in fit.terms),
        tuple(starts[1:-1].tolist()),
        from_usual @ mean,
        from_usual @ covariance @ from_usual.T,
    )


def _from_no_load(size: int, usual_load: float) -> FloatArray:
    """Count the motors' field from no load on: the fit counts its doubt of it from the usual load on."""
    out = np.eye(size)
    out[12:15, 15:18] = -usual_load * np.eye(3)
    return out
