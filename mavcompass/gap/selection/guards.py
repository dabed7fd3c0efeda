"""The guards: what keeps a name from being given wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import Floor
from mavcompass.gap.selection.direct import STEP, goes_with_a_load, unswitched
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.materiality import immaterial
from mavcompass.simulation.effects.effect import NEVER_S

TOO_SMALL = "it removes no more than healthy sensors may be off, or less than a tenth of the gap"
_AT_THE_END = 1e-3
_NEEDED, _INSIDE = 10.0, 0.1
# Readings that an effect changes by less than this (squared sigmas, in all) cannot judge it.
SILENT = 9.0
# A half that gains less than this share of what an effect gains in the other half says nothing of it.
_LITTLE = 0.1
_NEAREST_MAGNET_M = 0.03
# Gains that act behind a sensor's limit differ by some percent, and a reading may be wrong now and then.
_BEHIND_A_LIMIT, _PASSED = 1.02, 0.01


def refused(candidate: Identified, floor: Floor) -> tuple[str, str] | None:
    """Return the first effect that a guard refuses, and why."""
    fit = candidate.fit
    for place, (term, theta) in enumerate(zip(fit.terms, fit.thetas, strict=True)):
        reach = np.minimum(_AT_THE_END * (term.upper - term.lower), term.effect.scale)
        near = (theta - term.lower < reach) | (term.upper - theta < reach)
        outside = near & term.free & (np.abs(theta) > term.effect.scale) & (np.abs(theta) < NEVER_S)
        # What the recording does not tell may end anywhere: only what is needed there counts.
        if any(_needed(candidate, place, int(j)) for j in np.flatnonzero(outside)):
            return term.effect.id, "its best value lies at the end of the physical range"
    if (touching := _touched(candidate)) is not None:
        return touching, "its place lies on the path itself, where it could explain any reading"
    if _ends_on_a_step(candidate):
        return "clipping", "numbers as coarse as these end at one of their own steps"
    if _passed(candidate):
        return "clipping", "readings pass the limit"
    if unswitched(candidate.problem, fit):
        return next(
            t.effect.id for t in fit.terms if t.effect.switched
        ), "readings stay as they are where it is switched"
    if goes_with_a_load(candidate.problem, fit):
        return STEP, "it comes and goes with a load, whose field it is"
    if (worse := _vetoed(candidate)) is not None:
        return worse, "one half of the training data does not confirm what the other half says"
    if (small := immaterial(candidate, floor)) is not None:
        return small, TOO_SMALL
    return None


def _needed(candidate: Identified, place: int, parameter: int) -> bool:
    """Tell whether a fit becomes worse when one parameter is held a tenth of the way from the end to where
    its effect is least; under coarse numbers, whose rounding leads anywhere, all of the way."""
    fit = candidate.fit
    inside = _INSIDE if candidate.problem.replay.trace.step_mgauss == 0.0 else 1.0
    term = fit.terms[place]
    free, theta = term.free.copy(), fit.thetas[place].copy()
    free[parameter] = False
    theta[parameter] += inside * (np.clip(term.effect.neutral(), term.lower, term.upper) - theta)[parameter]
    terms = (*fit.terms[:place], replace(term, free=free), *fit.terms[place + 1 :])
    thetas = (*fit.thetas[:place], theta, *fit.thetas[place + 1 :])
    held = candidate.problem.fit(terms, thetas, fit.nuisance_thetas, iterations=4)
    return held.sse - fit.sse > _NEEDED


def _touched(candidate: Identified) -> str | None:
    """Refuse a magnet so near the path that its field is a spike of its own at a few readings."""
    if "spatial_dipole" not in candidate.fit.ids:
        return None
    position = candidate.problem.replay.signals.stimulus.position_ned_m
    place = candidate.fit.theta("spatial_dipole")[:3]
    nearest = float(np.nanmin(np.linalg.norm(position - place, axis=1)))
    return "spatial_dipole" if nearest < _NEAREST_MAGNET_M else None


def _ends_on_a_step(candidate: Identified) -> bool:
    """Tell a limit that the field would pass by less than a step of coarse numbers: rounding ends there."""
    step, fit, problem = candidate.problem.replay.trace.step_mgauss, candidate.fit, candidate.problem
    if step == 0.0 or "clipping" not in fit.ids:
        return False
    place = [term.effect.id for term in fit.terms].index("clipping")
    free = np.abs(problem.predict(fit.without(place)).mag_mgauss)[problem.usable]
    return float(free.max()) < float(fit.theta("clipping")[0]) + step


def _passed(candidate: Identified) -> bool:
    """Tell a limit that readings pass by more than noise and the gains behind it: nothing ends there."""
    fit, problem = candidate.fit, candidate.problem
    if "clipping" not in fit.ids:
        return False
    limit = _BEHIND_A_LIMIT * float(fit.theta("clipping")[0]) + 4.0 * float(problem.noise["mag"].rms.max())
    beyond = np.abs(problem.replay.measured.mag_mgauss[problem.usable]) > limit
    return float(beyond.any(axis=1).mean()) > _PASSED


def _vetoed(candidate: Identified) -> str | None:
    """Fit on each half of the training rows; an effect must help on the other half.

    A magnet that is passed once shows in one half only, or hardly in the other: a half that shows little of
    what there is to explain in the other has no say.
    """
    fit, problem = candidate.fit, candidate.problem
    halves = candidate.split.halves()
    gains: dict[str, float] = {}
    for own, other in (halves, halves[::-1]):
        mine, judge = problem.with_rows(own & problem.rows), problem.with_rows(other & problem.rows)
        trained = mine.fit(fit.terms, fit.thetas, fit.nuisance_thetas, iterations=3)
        for place, term in enumerate(trained.terms):
            here, _ = _gain(mine, trained, place)
            there, change = _gain(judge, trained, place)
            shown = here > max(SILENT + term.dimension, _LITTLE * _gain(judge, fit, place)[0])
            if shown and change > SILENT:
                gains[term.effect.id] = gains.get(term.effect.id, 0.0) + there
    if not gains:
        return None
    worst = min(gains, key=gains.__getitem__)
    return worst if gains[worst] <= 0.0 else None


def _gain(problem: Problem, fit: Fit, place: int) -> tuple[float, float]:
    """Return what one effect of a fit takes off the sum of squares on these rows, and how much it changes."""
    kept, left = (problem.residual(problem.predict(f)) for f in (fit, fit.without(place)))
    return float(left @ left - kept @ kept), float((left - kept) @ (left - kept))
