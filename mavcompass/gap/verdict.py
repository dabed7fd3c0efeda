"""The verdict: what may be said of a gap, from what was found and from what is left."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.gap.adequacy import Adequacy
from mavcompass.gap.floor import Floor, rms
from mavcompass.gap.hypothesis import Fit
from mavcompass.gap.identify import Identified
from mavcompass.gap.model import Problem
from mavcompass.gap.remainder import Remainder
from mavcompass.gap.result import Verdict
from mavcompass.gap.scatter import drift_gain
from mavcompass.gap.search import least_gain

_SURE = 0.90
_REMAINDER = 0.05
# Where even the baseline is not explained in detail, more may be left beside a name, and is flagged.
_REMAINDER_UNTRUSTED = 0.3
_LARGE_REMAINDER = 1.5
# No model of a vehicle is exact: what is left below this share of what was explained belongs to it.
_INEXACT = 0.03
_DRIFT_RIVALS = 6
_DRIFT_MARGIN = 6.0


@dataclass(frozen=True, slots=True)
class Answer:
    """Hold the verdict, the fit whose effects are named, and whether and where something is left."""

    verdict: Verdict
    named: Fit
    flagged: bool
    coordinate: str | None


def decide(
    identified: Identified,
    floor: Floor,
    remainder: Remainder,
    adequacy: Adequacy,
    traces: bool,
    half_testable: frozenset[str],
) -> Answer:
    """Decide what is said.

    `traces`: scatter, repeats or steps were named besides the fitted effects. `half_testable`: effects of
    which the recording shows a part only.
    """
    fit, none = identified.fit, identified.found.null
    flagged = adequacy.flagged and (floor.representative or _much_is_left(remainder, floor))
    coordinate = adequacy.coordinate if flagged else None
    if floor.representative and wanders(identified):
        return Answer("unknown", none, True, coordinate or "time")
    if not fit.terms and not traces:
        return Answer("unknown" if flagged else "no_gap", none, flagged, coordinate)
    if flagged:
        if not fit.terms or _confirmed(remainder.problem, remainder.fit, floor):
            return Answer("named_with_remainder", fit, True, coordinate)
        return Answer("unknown", none, True, coordinate)
    weight = dict(identified.found.weights).get(fit.ids, 1.0)
    sure = (weight >= _SURE and not fit.ids & half_testable) or not fit.terms
    return Answer("named" if sure else "ambiguous", fit, False, None)


def _much_is_left(remainder: Remainder, floor: Floor) -> bool:
    problem = remainder.problem
    measured, predicted = problem.replay.measured.mag_mgauss, problem.predict(remainder.fit).mag_mgauss
    scatter = remainder.scatter
    added = scatter.size**2 if scatter is not None and scatter.effect == "noise_excess" else 0.0
    left2 = rms((measured - predicted)[problem.usable]) ** 2 - added
    without = problem.predict(remainder.fit, effects=False).mag_mgauss
    explained = rms((predicted - without)[problem.usable])
    return left2 > (_LARGE_REMAINDER * floor.field_rms_mgauss) ** 2 + (_INEXACT * explained) ** 2


def wanders(identified: Identified) -> bool:
    """Tell whether a wandering offset explains the gap better than the named effects do.

    It may stand beside any explored set that is smaller than the best one.
    """
    best, problem = identified.found.best, identified.first
    search = identified.search.on(problem)
    own = search.score(best)
    rivals = [f for f in identified.found.explored.values() if len(f.terms) <= len(best.terms)]
    rivals = sorted({f.ids: f for f in [*rivals, best]}.values(), key=search.score)[:_DRIFT_RIVALS]
    cost = search.cost(1)
    for fit in rivals:
        gain, size = drift_gain(problem, fit)
        if size > 0.0 and gain > least_gain(4) and search.score(fit) - gain + cost < own - _DRIFT_MARGIN:
            return True
    return False


def _confirmed(problem: Problem, fit: Fit, floor: Floor) -> bool:
    """Tell whether named effects stand although something is left.

    They must hold nearly all of the gap: a look-alike of an unknown cause leaves much of it. What is left
    is measured above the floor, by the whitened sum of squares where the floor can be trusted in detail,
    otherwise by the field's mean square.
    """
    nominal, after = problem.predict(fit, effects=False), problem.predict(fit)
    share = _REMAINDER if floor.representative else _REMAINDER_UNTRUSTED
    if floor.representative:
        r0, r1 = problem.residual(nominal), problem.residual(after)
        before_excess, after_excess = float(r0 @ r0) - r0.size, float(r1 @ r1) - r1.size
    else:
        measured, rows = problem.replay.measured.mag_mgauss, problem.usable
        before_excess = rms((measured - nominal.mag_mgauss)[rows]) ** 2 - floor.field_rms_mgauss**2
        after_excess = rms((measured - after.mag_mgauss)[rows]) ** 2 - floor.field_rms_mgauss**2
    return before_excess > 0.0 and after_excess < share * before_excess
