"""How far a case is, in sigmas, from all that other effects can make: what a diagnosis could tell at best."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from operator import itemgetter

import numpy as np

from mavcompass.errors import UsageError
from mavcompass.frames import quaternion_to_matrix, rotate_back
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.diagnose import withheld_effects
from mavcompass.gap.fit.hypothesis import Fit, Term, placements
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search
from mavcompass.gap.replay.nominal import half_testable, replay, untestable_effects
from mavcompass.gap.replay.nuisance import REFERENCE_YAW, Prior
from mavcompass.gap.replay.rows import compass_rows, shared_period_s
from mavcompass.gap.residual.baseline import from_baseline
from mavcompass.gap.trial.cases import (
    CASE_NOISE,
    Label,
    affected,
    case_of,
    recipe_of,
    shifts,
    stimulus_of,
    to_track,
)
from mavcompass.simulation.effects import catalogue, parse
from mavcompass.simulation.effects.effect import Effect, Signals

_NO_NEARER = 0.99


def apart(label: Label) -> tuple[Label, float, float, float]:
    """Return a label with its size, its d_sep or d_perp, d_sep from all once it is restored, and how far the
    catalogue's model of the truth stays from it; nan where there is none."""
    truth, separation, own, truth_distance = label.ids, math.nan, math.nan, math.nan
    of_vehicles = label.generator != "bench"
    problem, others = (_of_others if of_vehicles else _bench)(label)
    if of_vehicles:
        label = replace(label, size_sigma=_size(problem))
    if shifts(truth):
        seen: Search | None = Search(problem, others)
        truth_distance = 0.0
        if of_vehicles and label.tier != "outside":
            seen, truth_distance = _as_modelled(label, Search(problem, others))
        separation = 0.0 if seen is None else _separation(label, seen)
        if seen is not None and label.tier == "withheld":
            own = _distance(seen, frozenset(truth), most=1)
    return label, separation, own, truth_distance


def _bench(label: Label) -> tuple[Problem, list[Effect]]:
    """Return the recording of a label without noise, and the effects that a diagnosis could choose."""
    stimulus = stimulus_of(recipe_of(label))
    replayed = replay(to_track(stimulus, affected(stimulus, [parse(text) for text in label.effects])))
    return Problem(replayed, CASE_NOISE, replayed.valid, Prior()), list(catalogue().values())


def _of_others(label: Label) -> tuple[Problem, list[Effect]]:
    """Return the flight without noise, as the diagnosis would see it, and the effects that it could choose.

    The vehicle is as what is known of it has it, its attitude the true one, and the readings are changed by
    what the effects make; noise and priors (yaw, field, iron in force, age) are the diagnosis's own.
    """
    case = case_of(label.generator, label.tier, label.seed)
    track, baseline = case.track, case.baseline
    assert baseline is not None and track.truth_q is not None
    period_s = shared_period_s([track, baseline], 1)
    replayed = replay(track, period_s=period_s)
    before = replay(baseline, period_s=period_s, most_averaged=replayed.averaged)
    compass = track.compasses[1]
    rows = compass_rows(track, compass, period_s)
    index = rows.index
    middles = np.searchsorted(rows.time_s, replayed.time_s)
    change = (case.clean_mgauss - case.clean_nominal_mgauss)[index]
    if rows.width > 1:
        change = averaged(change, rows.width)
    rotation = quaternion_to_matrix(track.truth_q.values[index][middles])
    stimulus = replace(replayed.signals.stimulus, rotation=rotation)
    reading = replace(replayed.signals.reading, mag_mgauss=rotate_back(rotation, stimulus.field_ned_mgauss))
    exact = replace(
        replayed, signals=Signals(stimulus, reading), nominal_mgauss=replayed.iron.raw(reading.mag_mgauss)
    )
    every = list(catalogue().values())
    floor = from_baseline(exact, before, every)
    facing = floor.prior.holds(REFERENCE_YAW)
    prior = replace(floor.prior, mean=np.where(facing, 0.0, floor.prior.mean))
    plain = Problem(exact, floor.noise, exact.valid, prior).predict(Fit(nuisances=prior.mean)).mag_mgauss
    exact = replace(exact, measured=replace(exact.measured, mag_mgauss=plain + change[middles]))
    unable = untestable_effects(exact, every, before.telemetry).keys() - half_testable(exact, every)
    return Problem(exact, floor.noise, exact.valid, prior), [e for e in every if e.id not in unable]


def _separation(label: Label, search: Search) -> float:
    """Return how far, in sigmas of the whole recording, the case is from what other effects can make.

    For a pair it is the lesser of the two distances with one member removed (a turn of the mounting that
    stays is known); for what the catalogue does not have, or is not to use, the distance to all that three
    others can make together.
    """
    if label.tier == "pair":
        return min(_distance(search, frozenset({n}), 2, _turned(label, search, n)) for n in label.ids)
    if label.tier == "single":
        return _distance(search, frozenset(label.ids), most=1)
    return _distance(search, akin(label.ids), most=3)


def akin(names: Iterable[str]) -> frozenset[str]:
    """Return effects of the catalogue with all that can look like them."""
    return withheld_effects(name for name in names if name in catalogue())


def _turned(label: Label, search: Search, removed: str) -> Fit | None:
    """Return the turn of the mounting by right angles that a pair keeps: no search goes from one to the
    next."""
    terms = {term.effect.id: term for term in search.terms if term.effect.kind == "discrete"}
    turns = [text for text in label.effects if text.partition(":")[0] in terms.keys() - {removed}]
    kept = [parse(text) for text in turns]
    known = search.problem.prior.mean
    return Fit(tuple(terms[s.effect.id] for s in kept), tuple(s.theta for s in kept), known) if kept else None


def _distance(search: Search, removed: frozenset[str], most: int, held: Fit | None = None) -> float:
    def nearest(terms: list[Term]) -> float:
        rest = search.on(search.problem)
        rest.terms = terms
        return rest.nearest(most, held).sse

    usable = [term for term in search.terms if term.effect.id not in removed]
    least = nearest(usable)
    if search.problem.prior.effects and least > _NO_NEARER * search.problem.null().sse:
        # Beside bent nuisances the normal equations may have pointed nowhere: each by itself.
        least = min([least, *(nearest([term]) for term in usable)])
    return math.sqrt(max(least, 0.0))


def _as_modelled(label: Label, search: Search) -> tuple[Search | None, float]:
    """Return a search of what the catalogue's own model makes of the truth, and how far that stays from it.

    There is none where the flight cannot test the truth.
    """
    terms = {term.effect.id: term for term in search.terms}
    if not terms.keys() >= set(label.ids):
        return None, math.nan
    try:
        settings = [parse(text) for text in label.effects]
    except UsageError:
        # Another make's effect may be larger than the catalogue calls physical.
        return search, math.nan
    problem = search.problem
    named = tuple(terms[s.effect.id] for s in settings)
    placed = product(*(placements(s.effect, s.theta, problem.replay.iron.offset_mgauss) for s in settings))
    starts = [Fit(named, thetas, problem.prior.mean) for thetas in placed]
    least, nearest = min(((problem.fit(start).sse, start) for start in starts), key=itemgetter(0))
    made = problem.predict(nearest).mag_mgauss
    replayed = replace(problem.replay, measured=replace(problem.replay.measured, mag_mgauss=made))
    modelled = search.on(Problem(replayed, problem.noise, problem.rows, problem.prior))
    return modelled, math.sqrt(max(least, 0.0))


def _size(problem: Problem) -> float:
    """Return the whitened length of what the effects change, nothing else being fitted."""
    known = Fit(nuisances=problem.prior.mean)
    return float(np.linalg.norm(problem.residual(problem.predict(known))))
