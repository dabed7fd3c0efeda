"""Choose the effects: search, then the guards that keep a name from being given wrongly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Found, Mask, Problem, Search, Term, pruned
from mavcompass.gap.left import Floor, apart, foreseen_places, rms, widened
from mavcompass.gap.replay import WHEREABOUTS, Replay, level_mgauss, whereabouts
from mavcompass.gap.selection.guards import TOO_SMALL, refused
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.levels import ABOVE, FEW_NAMES, at_floor, evident, needs_none
from mavcompass.gap.selection.materiality import STRAINED, worthwhile
from mavcompass.gap.selection.rivals import NO_WORSE, alike, likelier, plainer, simplest, with_evident
from mavcompass.gap.selection.split import Split, probe, with_parts, with_windows
from mavcompass.gap.selection.transient import (
    moments,
    near_places,
    switched,
    switches,
    told,
    transients,
    with_moments,
)
from mavcompass.simulation.effects.effect import PLACED, Effect

_PASSES = 2
# What is switched is told better once it is told: so often, while it takes this share of the rows more.
_CALMINGS, _FEW = 3, 0.01
_CLOSINGS_IN = 6
# Times the floor from which a single row stands out.
_LOUD = 3.0
# The share of rows that a passing disturbance takes at most.
_PASSING = 0.25
# A gap so many floors high, of whose square the best set explains no more than this share, stays unknown.
_FAR_ABOVE, _HOPEFUL = 2.0, 0.3
# What is too small to be named beside others is another possibility from so many squared sigmas on, of all
# readings and of those that were not fitted.
_LISTED = (36.0, 16.0)
# Few effects are named in the place of many where they hold so much of the square above the floor.
_NEARLY_ALL = 0.9
# Places may wander where so much is left of each reading, and must leave no more than this share of it; so
# many smaller sets are fitted with them.
_UNEXPLAINED, _WANDERED, _LIKELY = 1.3, 0.7, 3


def identify(
    replay: Replay, floor: Floor, split: Split, effects: Sequence[Effect], noise_known: bool
) -> tuple[Identified, Floor]:
    """Search and guard; where the noise is not known estimate it from what is left, and repeat.

    Where a change that was found takes time, the readings meanwhile are set aside and the search repeated;
    of something that is switched as long as it is told better each time.
    If nothing that changes is found then, they were the whole disturbance, and must stay; and they stay where
    the rest is explained no better without them.
    """
    result, own = _searched(replay, floor, split, effects, 1 if noise_known else _PASSES)
    none: Mask = np.zeros(replay.time_s.size, dtype=np.bool_)
    changing, switching, near, known = none, none, none, none
    for _ in range(_CALMINGS):
        when = moments(result.fit)
        changing = changing | transients(result.problem, result.fit, when)
        switching = switching | switched(result.problem, result.fit)
        near = near | near_places(result.problem, result.fit)
        aside = changing | switching | near
        again = bool(known.any())
        if aside.sum() - known.sum() <= (_FEW * aside.size if again else 0):
            break
        known = aside
        notes = (*replay.notes, *told(replay, changing, switching, near))
        fewer = replace(replay, valid=replay.valid & ~aside, notes=notes)
        calm = replace(split, train=split.train & ~aside, test=split.test & ~aside)
        start = floor
        if not floor.measured:
            kept = Problem(fewer, result.problem.noise, calm.train, result.problem.prior)
            start = widened(floor, kept, kept.refit(result.fit))
        calmer, settled = _searched(fewer, start, calm, effects, 1, (result.fit.terms, result.fit.thetas))
        # Under a noise that is known both can be compared.
        still = not (moments(calmer.fit) or switches(calmer.fit) or _placed(calmer.fit))
        most = _each(result) * (NO_WORSE if again else 1.0)
        if still or (floor.measured and _each(calmer) > most):
            break
        result, own = replace(calmer, fit=with_moments(calmer.problem, calmer.fit, when)), settled
        if not switches(result.fit):
            break
    calmed = result.problem.replay is not replay
    return (_clear(result) if calmed and switches(result.fit) else result), own


def _clear(found: Identified) -> Identified:
    """Return what was found fitted without readings of both on and off as it is switched at last.

    They are few: no search is repeated for them.
    """
    before, split = found.problem, found.split
    clear = ~switched(before, found.fit)
    if clear[before.usable].all():
        return found
    fewer = replace(before.replay, valid=before.replay.valid & clear)
    calm = replace(split, train=split.train & clear, test=split.test & clear)
    problem = Problem(fewer, before.noise, calm.train, before.prior)
    fit, none = problem.refit(found.fit), problem.null(found.found.null)
    return replace(found, problem=problem, split=calm, fit=fit, found=replace(found.found, null=none))


def _each(found: Identified) -> float:
    """Return the whitened sum of squares that a chosen fit leaves, of each of its rows."""
    return found.fit.sse / max(found.problem.count, 1)


def _searched(
    replay: Replay,
    floor: Floor,
    split: Split,
    effects: Sequence[Effect],
    passes: int,
    likely: tuple[Sequence[Term], Sequence[FloatArray]] | None = None,
) -> tuple[Identified, Floor]:
    """Search and guard, under a noise learnt in passes; what was `likely` with other rows is tried first."""
    # An independent attitude has no errors that last for seconds.
    exact = floor.representative or replay.reference.kind == "columns"
    whole = Problem(replay, floor.noise, split.train | split.test, floor.prior)
    nothing = whole.null()
    split = _parted(whole, nothing, floor, split)
    for turn in range(passes):
        problem = Problem(replay, floor.noise, split.train, floor.prior)
        problem.null(nothing)
        search = Search(problem, effects, partial(worthwhile, problem, floor), exact)
        none = search.nothing()
        result = Identified(problem, split, none, none.best, (), search, problem)
        names = not needs_none(result, floor)
        if names:
            hopeless = partial(_hopeless, result, floor)
            tried = [problem.fit(*likely, nothing.nuisance_thetas)] if likely else ()
            found = search.run(likely=tried, hopeless=hopeless)
            wandering = _with_wander(problem, floor, found)
            if wandering is not None:
                floor, problem, placed = wandering
                search = Search(problem, effects, partial(worthwhile, problem, floor), exact)
                found = search.run(likely=placed)
                nothing_named = search.nothing().best
                result = replace(result, problem=problem, search=search, first=problem, fit=nothing_named)
            result = replace(result, found=found)
            floor = foreseen_places(floor, problem, found.best, split.test)
            names = not _hopeless(result, floor, found.best)
        best = replace(result, fit=found.best) if names else result
        if turn + 1 < passes:
            # Where the noise is only to be learnt, moments need be no nearer.
            allowed = _allowed(best, floor)
            wider = widened(floor, allowed.problem, allowed.fit)
            if wider is not floor:
                floor = wider
                continue
        result = _allowed(_moments_in_training(best), floor)
        break
    chosen = _guarded(result, floor) if names else result
    chosen.search.forget()
    return chosen, floor


def _with_wander(problem: Problem, floor: Floor, found: Found) -> tuple[Floor, Problem, list[Fit]] | None:
    """Let the places wander where that explains what is left of something at a place.

    Return floor and problem with that, and the sets that held something at a place fitted anew.
    """
    curves = problem.replay.place_curves_m
    known = any(nuisance.effect.id == WHEREABOUTS for nuisance in problem.nuisances)
    quiet = found.best.sse < _UNEXPLAINED * 3 * problem.count
    if known or quiet or not curves.size or not _placed(found.best):
        return None
    wandering = replace(floor, prior=floor.prior.beside(whereabouts(curves)))
    wide = Problem(problem.replay, floor.noise, problem.rows, wandering.prior)
    placed = [f for f in found.explored.values() if _placed(f) and len(f.terms) < len(found.best.terms)]
    likely = [
        wide.fit(fit.terms, fit.thetas, (*fit.nuisance_thetas, np.zeros(curves.shape[2])))
        for fit in (found.best, *sorted(placed, key=lambda f: f.sse)[:_LIKELY])
    ]
    explained = min(fit.sse for fit in likely) < _WANDERED * found.best.sse
    return (wandering, wide, likely) if explained else None


def _placed(fit: Fit) -> bool:
    """Tell whether a set holds something that belongs to a place."""
    return any(term.effect.needs & PLACED for term in fit.terms)


def _hopeless(candidate: Identified, floor: Floor, fit: Fit) -> bool:
    """Tell whether the best set explains so little of field or heading, whose floor the baseline shows, that
    nothing in it will be named."""
    if not floor.measured or floor.representative or not fit.terms:
        return False
    return any(
        before > _FAR_ABOVE * least and before**2 - after**2 < _HOPEFUL * (before**2 - least**2)
        for before, after, least in _closed(candidate, fit, floor)
    )


def _closed(candidate: Identified, fit: Fit, floor: Floor) -> list[tuple[float, float, float]]:
    """Return what is there without effects, what a fit leaves, and the floor: for field (mG) and heading
    (deg)."""
    problem = candidate.problem
    replay, rows = problem.replay, candidate.split.train | candidate.split.test
    none, left = (
        apart(replay, replay.measured.mag_mgauss, problem.predict(one).mag_mgauss, rows & problem.usable)
        for one in (candidate.found.null, fit)
    )
    # Scatter is explained by no set, and counts against none.
    scatter = rms(problem.sigma_mgauss)
    floors = (
        max(floor.field_rms_mgauss, scatter),
        max(floor.heading_rms_deg, math.degrees(scatter / level_mgauss(replay))),
    )
    return list(zip(none, left, floors, strict=True))


def _parted(problem: Problem, nothing: Fit, floor: Floor, split: Split) -> Split:
    """Let what disturbs for a short while, and nothing that is known explains, be fitted and judged alike.

    A gap that is there all the time may swing with the vehicle's turns: its blocks are long enough.
    """
    replay, rows = problem.replay, split.train | split.test
    # A gap that bends what is known is loud everywhere: as it is known, it may be loud for a while only.
    known = Fit((), (), tuple(n.mean for n in problem.nuisances), math.inf)
    for fit in (nothing, known):
        left = replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss
        loud = rows & (np.sqrt(np.mean(left**2, axis=1)) > _LOUD * floor.field_rms_mgauss)
        if 0 < loud.sum() < _PASSING * rows.sum():
            return with_parts(split, replay.time_s, loud)
    return split


def _guarded(candidate: Identified, floor: Floor) -> Identified:
    """Choose among what no guard refuses, and name what is as good."""
    search, fewest = candidate.search, max(len(candidate.fit.terms), 1)
    score = search.criteria.score
    fell = candidate.dropped and not search.criteria.exact and fewest < len(candidate.found.best.terms)
    if fell and search.likeliest(fewest) != candidate.fit.ids:
        # What was needed beside a refused effect need not be what does best without it.
        fewer = search.run(fewest).best
        # Bent by force, what is known of the vehicle would imitate nearly anything.
        bent = search.problem.strain(fewer) > search.problem.strain(candidate.fit) + STRAINED
        if fewer.ids != candidate.fit.ids and not bent and score(fewer) < score(candidate.fit):
            rival = _allowed(_moments_in_training(replace(candidate, fit=fewer)), floor)
            fuller = len(rival.fit.terms) - len(candidate.fit.terms)
            better = fuller > 0 or (fuller == 0 and score(rival.fit) <= score(candidate.fit))
            candidate = rival if better else candidate
    found_some = bool(candidate.fit.terms or candidate.dropped)
    if found_some and not floor.representative:
        candidate = simplest(candidate, floor) if floor.measured else plainer(candidate)
    candidate = _few_beside_unknown(candidate, floor)
    candidate = replace(candidate, fit=pruned(candidate.search.problem, candidate.fit))
    if candidate.fit.terms and candidate.fit.ids != candidate.found.best.ids:
        # What the search was as sure of is no longer what is named.
        refused_ids = frozenset(dict(candidate.dropped)) - candidate.fit.ids
        explored = {**candidate.search.explored, candidate.fit.ids: candidate.fit}
        weights = candidate.search.criteria.weights(candidate.fit, explored, refused_ids)
        candidate = replace(candidate, found=replace(candidate.found, weights=weights))
    others = (*alike(candidate), *with_evident(candidate), *likelier(candidate))
    return replace(candidate, as_good=(*candidate.as_good, *others))


def _few_beside_unknown(candidate: Identified, floor: Floor) -> Identified:
    """Where something is left, keep two effects that hold nearly all: many together imitate what nobody
    knows."""
    fit = candidate.fit
    if floor.representative or len(fit.terms) <= FEW_NAMES or at_floor(candidate, fit, floor, ABOVE):
        return candidate
    while len(fit.terms) > FEW_NAMES:
        fit = min((candidate.search.without(fit, term.effect.id) for term in fit.terms), key=lambda f: f.sse)
    little = any(
        before > ABOVE * least and before**2 - after**2 < _NEARLY_ALL * (before**2 - least**2)
        for before, after, least in _closed(candidate, fit, floor)
    )
    fewer = replace(candidate, fit=fit)
    return candidate if little or refused(fewer, floor) else fewer


def _allowed(candidate: Identified, floor: Floor) -> Identified:
    """Take the effects out that a guard refuses, one after the other."""
    while candidate.fit.terms and (reason := refused(candidate, floor)) is not None:
        rest = candidate.search.without(candidate.fit, reason[0])
        dropped = tuple({**dict(candidate.dropped), reason[0]: reason[1]}.items())
        beside = candidate.evident
        if reason[1] is TOO_SMALL and not floor.representative and evident(candidate, rest, *_LISTED):
            beside |= {reason[0]}
        candidate = replace(candidate, fit=rest, dropped=dropped, evident=beside)
    return candidate


def _moments_in_training(candidate: Identified) -> Identified:
    """Where something changes inside a held-out block, close in on it with narrow training windows."""
    replay = candidate.problem.replay
    for _ in range(_CLOSINGS_IN):
        probes = [probe(candidate.split, replay.time_s, m) for m in moments(candidate.fit)]
        loose = [p for p in probes if p is not None]
        if not loose:
            break
        split = with_windows(candidate.split, replay.time_s, replay.valid, loose)
        if split.train.sum() == candidate.split.train.sum():
            break
        problem = candidate.problem.with_rows(split.train)
        search = candidate.search.on(problem)
        fit = search.polished(problem.refit(candidate.fit), moments=True)
        search.explored = {fit.ids: fit}
        candidate = replace(candidate, problem=problem, split=split, fit=fit, search=search)
    return candidate
