"""The beam over sets of effects: the likeliest of each size by their normal equations, without a fit."""

from __future__ import annotations

import math
from collections.abc import Iterable

from mavcompass.gap.fit.candidates import Candidate, Candidates
from mavcompass.gap.fit.criteria import Criteria

_BEAM = 5
# Sets that come so near to the best one of their size are fitted through the simulation, so many at most.
_NEAR, _FITTED = 40.0, 4


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
