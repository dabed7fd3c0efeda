"""Where readings lie: at their floor or above it, and what is certain below it."""

from __future__ import annotations

import numpy as np

from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import Floor, apart, most_structured
from mavcompass.gap.selection.identified import Identified

# A set that leaves no more than this many floors explains enough.
_AT_FLOOR = 1.25
# What lies above the floor by less may be the floor's own uncertainty.
ABOVE = 1.3
# So many names stand beside something that is left.
FEW_NAMES = 2
# Squared sigmas that an effect must be worth, once blocks agree, and on rows that were not fitted.
EVIDENT, _EVIDENT_HELD_OUT = 81.0, 25.0
# A gap that is no larger than this many floors without an effect needs no such effect: a floor that was
# measured, and one that was stated. A baseline's floor holds what another flight may add to it.
NEEDED_ABOVE = {True: 0.9, False: 1.25}
# The mean square of whitened readings, and the excess of what is smooth in one coordinate, above which they
# are searched though they lie at their floor.
_LOUD, _STRUCTURED = 1.25, 8.0
# An effect acts where it changes readings by more than this share of its most.
_ACTS = 0.5


def needs_none(candidate: Identified, floor: Floor) -> bool:
    """Tell whether field and heading lie at the floor without any effect, on rows that were not fitted."""
    stated = not floor.measured and candidate.problem.replay.reference.kind == "columns"
    if floor.representative or stated:
        # An exact floor is asked for more than its size, and that of an independent attitude is generous.
        return False
    if floor.measured and not candidate.problem.straight(candidate.problem.null()):
        # What a baseline taught of the vehicle was bent to come there, further than by chance.
        return False
    if floor.measured and max(whitened_left(candidate, candidate.found.null), default=0.0) > _LOUD:
        # Readings that know better than their floor may know an effect below it.
        return False
    if not at_floor(candidate, candidate.found.null, floor, NEEDED_ABOVE[floor.measured]):
        return False
    return not (floor.measured and most_structured(candidate.problem, candidate.found.null) > _STRUCTURED)


def lost_in_the_floor(problem: Problem, fit: Fit, floor: Floor) -> bool:
    """Tell whether effects are no larger than what two flights of a healthy vehicle differ by, in readings
    that lie below the floor without them: all but those of a moment, a switch or a place which lift the
    readings above it where they act."""
    whole, replay = problem.predict(fit).mag_mgauss, problem.replay
    for place, term in enumerate(fit.terms):
        if not term.effect.local:
            continue
        without = problem.predict(fit.without(place)).mag_mgauss
        change = np.linalg.norm(whole - without, axis=1)
        acts = problem.usable & (change > _ACTS * change[problem.usable].max())
        field, heading = apart(replay, replay.measured.mag_mgauss, without, acts)
        if field > floor.field_rms_mgauss or heading > floor.heading_rms_deg:
            return False
    return True


def whitened_left(candidate: Identified, fit: Fit) -> list[float]:
    """Return the mean square of whitened readings that a fit leaves, of fitted rows and of others."""
    problem = candidate.problem
    rows = [p.residual(p.predict(fit)) for p in (problem, problem.with_rows(candidate.split.test))]
    return [float(np.mean(r**2)) for r in rows if r.size]


def at_floor(candidate: Identified, fit: Fit, floor: Floor, within: float = _AT_FLOOR) -> bool:
    """Tell whether field and heading lie within so many floors with a fit, on rows that were not fitted."""
    problem, rows = candidate.problem, candidate.split.test
    if not rows.any():
        return False
    replay = problem.replay
    field, heading = apart(replay, replay.measured.mag_mgauss, problem.predict(fit).mag_mgauss, rows)
    return field < within * floor.field_rms_mgauss and heading < within * floor.heading_rms_deg


def evident(
    candidate: Identified, rest: Fit, least: float = EVIDENT, held_out: float = _EVIDENT_HELD_OUT
) -> bool:
    """Tell whether readings that were fitted, and those that were not, know an effect that is too small to
    be named: what is left without it is `rest`. It must be worth `least` squared sigmas, and `held_out`."""
    problem = candidate.problem
    gain = rest.sse - candidate.fit.sse
    if gain < least or not candidate.split.test.any():
        return False
    held = problem.with_rows(candidate.split.test)
    without, beside = (float(np.sum(held.residual(held.predict(f)) ** 2)) for f in (rest, candidate.fit))
    if without - beside < held_out:
        return False
    return gain > least * candidate.search.criteria.contradiction(rest, candidate.fit)
