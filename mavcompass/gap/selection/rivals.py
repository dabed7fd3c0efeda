"""What else could be named: sets that explain a gap as well, and the plainest of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from mavcompass.gap.fit import Fit, Search, placements
from mavcompass.gap.left import Floor, apart
from mavcompass.gap.replay import IRON_OFFSET
from mavcompass.gap.selection.guards import refused
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.levels import at_floor, evident
from mavcompass.gap.selection.materiality import STRAINED
from mavcompass.simulation.effects.effect import Effect

# So many rivals are looked at, and told.
_RIVALS = 4
# What still leaves so many times as much as the chosen set after some steps comes nowhere near by more.
_ITERATIONS, _BEYOND = 3, 10.0
# By so much of EBIC's score.
_FAR_LIKELIER = 40.0
# What leaves no more than this many times as much is no worse.
NO_WORSE = 1.05
# How near to the iron in force a turned compass and a named hard iron must come together.
_IRON_SHARE = 0.35


def simplest(candidate: Identified, floor: Floor) -> Identified:
    """Of the sets that reach the floor on rows that were not fitted, take the one with fewest parameters.

    What fits closer than the floor fits the errors of the model.
    """
    chosen, explored = candidate.fit, candidate.search.explored.values()
    # Where guards left nothing, one effect may still do what several did between them.
    most_terms = max(len(chosen.terms), 1)
    known = [f for f in explored if 0 < len(f.terms) <= most_terms and f.ids != chosen.ids]
    known = sorted((f for f in known if f.sse < _BEYOND * chosen.sse), key=lambda f: f.sse)[:_RIVALS]
    rivals = {f.ids: candidate.problem.refit(f) for f in known}
    rivals |= {f.ids: f for f in _substitutes(candidate) if f.ids not in rivals}
    # Bent by force, what is known of the vehicle would imitate nearly anything.
    most = candidate.problem.strain(chosen) + STRAINED
    near = [f for f in rivals.values() if candidate.problem.strain(f) < most]
    good = [f for f in near if at_floor(candidate, f, floor)]
    doubted: tuple[frozenset[str], ...] = ()
    if not (chosen.terms and at_floor(candidate, chosen, floor)):
        allowed = [f for f in good if refused(replace(candidate, fit=f), floor) is None]
        if not chosen.terms:
            # Nothing may do it as well, beside what is known of vehicle and place.
            none = candidate.problem.null()
            allowed = [f for f in allowed if candidate.search.criteria.grows(none, f)]
        if not allowed:
            return replace(candidate, as_good=tuple(f.ids for f in _no_worse(candidate, near)))
        likeliest = min(allowed, key=candidate.search.criteria.score)
        if chosen.terms:
            # What the search preferred fits the rest better.
            doubted = (chosen.ids,)
        else:
            # Guards took everything: what they refuse by itself is no rival either, unless it looks alike and
            # fits better.
            doubted = tuple(f.ids for f in good if _is_better_alias(candidate.search, f, likeliest))
            good = allowed
        chosen = likeliest
        good = [f for f in good if f is not chosen]
    # An alias that the search passed over is a rival, but no reason to change the name.
    simpler = [f for f in good if f.dimension < chosen.dimension and f.ids in candidate.search.explored]
    if any(not term.effect.affine for term in chosen.terms):
        # What readings that were not fitted know for certain is no error of the model.
        simpler = [f for f in simpler if not evident(replace(candidate, fit=chosen), f)]
    best = min(simpler, key=lambda f: (f.dimension, f.sse), default=chosen)
    others = tuple(f.ids for f in [chosen, *good] if f.ids != best.ids)
    return replace(candidate, fit=best, as_good=others + doubted)


def plainer(candidate: Identified) -> Identified:
    """Take an alias with fewer parameters that leaves no more of field and heading on rows that were not
    fitted.

    What the search chose stays a rival where it is the likelier by its own rows.
    """
    chosen, score = candidate.fit, candidate.search.criteria.score
    smaller = [f for f in _substitutes(candidate) if f.dimension < chosen.dimension]
    good = _no_worse(candidate, smaller)
    if not good:
        return candidate
    best = min(good, key=lambda f: f.sse)
    likelier = (chosen.ids,) if score(chosen) < score(best) else ()
    return replace(candidate, fit=best, as_good=(*candidate.as_good, *likelier))


def alike(candidate: Identified) -> tuple[frozenset[str], ...]:
    """Return the sets that the recording cannot tell from the chosen one, whatever the search found.

    A compass that is read slowly, averaged and repeated smooths by nature: a lag may be a low pass. A field
    that falls with the height comes from below: of everywhere below, or of one thing there. A compass that is
    turned alone leaves the vehicle's iron as it was, which looks like another iron beside one turned with it.
    """
    ids, tried = candidate.fit.ids, {term.effect.id for term in candidate.search.terms}
    out = []
    if "transport_lag" in ids and "low_pass" not in tried:
        out.append(ids - {"transport_lag"} | {"low_pass"})
    if "height_anomaly" in ids and "spatial_dipole" in tried:
        out.append(ids - {"height_anomaly"} | {"spatial_dipole"})
    if {"orientation", "hard_iron"} <= ids and _iron_stayed(candidate):
        out.append(ids - {"hard_iron"})
    return tuple(out)


def likelier(candidate: Identified) -> tuple[frozenset[str], ...]:
    """Return the sets that the search found far likelier than the chosen one, and no guard refuses."""
    search, chosen = candidate.search, candidate.fit
    refused_ids = dict(candidate.dropped).keys() - chosen.ids
    most = search.criteria.score(chosen) - _FAR_LIKELIER
    rivals = {ids: search.criteria.score(f) for ids, f in search.explored.items() if not ids & refused_ids}
    ranked = sorted((ids for ids, score in rivals.items() if score < most), key=rivals.__getitem__)
    return tuple(ids for ids in ranked[:_RIVALS] if ids not in candidate.as_good) if chosen.terms else ()


def with_evident(candidate: Identified) -> list[frozenset[str]]:
    """Return the chosen set with what is certain, and too small to be named, beside it."""
    ids, more = candidate.fit.ids, sorted(candidate.evident - candidate.fit.ids)
    if not ids:
        return []
    return [ids.union(some) for size in (1, 2) for some in combinations(more, size)]


def _is_better_alias(search: Search, other: Fit, chosen: Fit) -> bool:
    """Tell whether a set has an alias in the place of one effect of the chosen one, and is likelier."""
    mine, its = chosen.ids - other.ids, other.ids - chosen.ids
    if len(mine) != 1 or len(its) != 1 or search.criteria.score(other) >= search.criteria.score(chosen):
        return False
    return any(term.effect.id in mine and its <= set(term.effect.aliases) for term in chosen.terms)


def _iron_stayed(candidate: Identified) -> bool:
    """Tell whether the named hard iron is what a turned compass makes of the iron in force, taken back."""
    fit, replay = candidate.fit, candidate.problem.replay
    iron = replay.iron.offset_mgauss.copy()
    for nuisance, theta in zip(candidate.problem.nuisances, fit.nuisance_thetas, strict=True):
        if nuisance.effect.id == IRON_OFFSET:
            iron += theta[:3]
    turn = next(term.effect for term in fit.terms if term.effect.id == "orientation")
    alone = replay.signals.with_mag(np.tile(iron, (replay.time_s.size, 1)))
    named = alone.with_mag(alone.reading.mag_mgauss + fit.theta("hard_iron"))
    turned, whole = (turn.forward(s, fit.theta("orientation"), {}, None) for s in (alone, named))
    moved = np.linalg.norm(turned.reading.mag_mgauss[0] - iron)
    return float(np.linalg.norm(whole.reading.mag_mgauss[0] - iron)) < _IRON_SHARE * float(moved)


def _no_worse(candidate: Identified, rivals: Sequence[Fit]) -> list[Fit]:
    """Return the rivals that leave no more of field and heading than what was chosen, where nothing was
    fitted."""
    replay, rows = candidate.problem.replay, candidate.split.test
    if not rows.any():
        return []

    def left(fit: Fit) -> tuple[float, float]:
        predicted = candidate.problem.predict(fit).mag_mgauss
        return apart(replay, replay.measured.mag_mgauss, predicted, rows)

    most = [NO_WORSE * value for value in left(candidate.fit)]
    return [f for f in rivals if all(value <= limit for value, limit in zip(left(f), most, strict=True))]


def _substitutes(candidate: Identified) -> list[Fit]:
    """Fit the chosen set with an alias in the place of one of its effects: no search need have tried it."""
    chosen, problem = candidate.fit, candidate.problem
    terms = {term.effect.id: term for term in candidate.search.terms}
    out, iron = [], problem.replay.iron.offset_mgauss
    for place, term in enumerate(chosen.terms):
        for alias in term.effect.aliases:
            if alias not in terms or alias in chosen.ids:
                continue
            rest, other = chosen.without(place), terms[alias]
            guesses = placements(other.effect, other.effect.neutral(), iron)
            if other.effect.starts is not None:
                # A time for a time; what else needs a start of its own is for the search.
                guesses = [chosen.thetas[place]] if _of_one_kind(term.effect, other.effect) else []
            members = (*rest.terms, other)
            fits = [
                problem.fit(members, (*rest.thetas, guess), chosen.nuisance_thetas, _ITERATIONS)
                for guess in guesses
            ]
            fits = [problem.refit(f) for f in fits if f.sse < _BEYOND * chosen.sse]
            out += sorted(fits, key=lambda f: f.sse)[:1]
    return out


def _of_one_kind(one: Effect, other: Effect) -> bool:
    """Tell whether two effects have the same number of parameters, in the same units."""
    return [p.unit for p in one.parameters] == [p.unit for p in other.parameters]
