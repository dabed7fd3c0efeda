"""The verdict: what may be said of a gap, from what was found and from what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.gap.answer.naming import held_by
from mavcompass.gap.fit import Fit, Problem, least_gain
from mavcompass.gap.left import Adequacy, Floor, drift_gain, rms
from mavcompass.gap.replay import Replay
from mavcompass.gap.result import Closing, Verdict
from mavcompass.gap.selection import (
    ABOVE,
    EVIDENT,
    FEW_NAMES,
    NEEDED_ABOVE,
    Identified,
    Remainder,
    moments,
    whitened_left,
)

LINE = "ac_interference"
# What a set holds of the probability where it is sure, and each name beside a remainder.
_SURE, _HELD = 0.90, 0.80
_REMAINDER = 0.05
# Where even the baseline is not explained in detail, more may be left beside a name, and is flagged.
_REMAINDER_UNTRUSTED = 0.4
# Effects that follow one moment, one place or one load, and so fit much that they did not make.
_PLIANT = frozenset(
    {
        "hard_iron_step", "relay_field", "spatial_dipole", "field_gradient", "height_anomaly", "hysteresis",
        "eddy_current", "temperature_bias", "temperature_sensitivity", "ac_interference", "per_motor",
    }
)  # fmt: skip
_TURNS = frozenset({"misalignment", "orientation", "declination"})
# How many moments of change these have where they are there to stay.
_STAYING = {"spatial_dipole": 0, "hard_iron_step": 1}
_NEARLY_ALTERNATING = 0.85
# More than healthy vehicles leave of a model that is never exact: squared sigmas by which what is known is
# bent beside names, and how seldom chance bends it so far without any; structure that is left beside names
# over what is left in all, along the motion and along anything; and the mean square of whitened readings, of
# fitted ones and others, of fitted ones alone, and beside names (which leave 1 to 2 where they are right).
_BENT, _BENT_UNNAMED = 60.0, 1e-5
_STRUCTURED_ALONG, _STRUCTURED = 12.0, 20.0
_LOUD, _LOUD_FITTED, _LOUD_BESIDE = 1.4, 2.0, 3.0
# Names that leave more than this share of what is louder than noise are no explanation of it.
_QUIETER = 0.5
# A line that sweeps is one of readings which scatter by this share of their noise at least, as a square.
_SCATTERS = 0.8
_ALONG = frozenset({"mag: heading harmonics", "mag: direction, cubic", "mag: rate"})
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
    flagged = adequacy.flagged and floor.representative
    coordinate = adequacy.coordinate if flagged else None
    if floor.representative and wanders(identified):
        return Answer("unknown", none, True, coordinate or "time")
    if not fit.terms and not traces:
        return Answer("unknown" if flagged else "no_gap", none, flagged, coordinate)
    if flagged:
        few = len(fit.terms) <= FEW_NAMES
        if not fit.terms or (few and _confirmed(remainder.problem, remainder.fit, floor)):
            return Answer("named_with_remainder", fit, True, coordinate)
        return Answer("unknown", none, True, coordinate)
    weight = dict(identified.found.weights).get(fit.ids, 1.0)
    unique = weight >= _SURE and not fit.ids & half_testable and not identified.as_good
    sure = unique or not fit.terms
    return Answer("named" if sure else "ambiguous", fit, False, None)


def consistent(
    answer: Answer,
    field: Closing,
    heading: Closing,
    coordinate: str | None,
    floor: Floor,
    none: Fit,
    traces: bool,
    turns: bool,
    replay: Replay,
    certain: bool,
    level_known: bool = True,
    varies: bool = False,
) -> Answer:
    """Return an answer that does not contradict its own figures.

    Where a vehicle neither turns nor tilts and no baseline tells (not `turns`), silence says nothing, and a
    constant offset is no gap; what `varies` by more than the floor is one all the same. No gap only where
    nothing lies above the floor; named only where what is left does not; beside a remainder only causes that
    hold nearly all of the gap, and few of them, since many together imitate anything unknown. What is
    `certain` to be there need not lie above the floor; where the sensors that level the attitude are off (not
    `level_known`), it may be the attitude's, and must.
    """
    if not turns and answer.verdict == "no_gap":
        if varies:
            return Answer("unknown", none, True, coordinate)
        return Answer("not_testable", none, False, None)
    if floor.representative:
        return answer
    quiet = all(c.nominal < NEEDED_ABOVE[floor.measured] * c.floor for c in (field, heading))
    if floor.measured and quiet and not (traces or certain):
        return Answer("no_gap", none, False, None)
    gap = _above(field.nominal, field.floor) or _above(heading.nominal, heading.floor)
    if answer.verdict == "unknown":
        return answer if gap else replace(answer, verdict="no_gap", flagged=False, coordinate=None)
    left = _above(field.after, field.floor) or _above(heading.after, heading.floor)
    shrinks = any(c.shrink_ci95[0] > 0.0 for c in (field, heading))
    sure = level_known and (certain or (shrinks and none.sse - answer.named.sse > EVIDENT))
    if answer.named.terms and not gap and not sure:
        # Below the floor only what surely shrinks, or is certain, is a cause.
        return replace(answer, verdict="named" if traces else "no_gap", named=none)
    # What single readings tell stays told, whatever else there is.
    owned = Answer("named_with_remainder" if traces else "unknown", none, True, coordinate)
    if not answer.named.terms:
        return owned if left else answer
    little = hold_little(field, heading)
    if not left:
        unsure = answer.verdict == "named" and (little or _unsure(answer.named, floor, replay, traces))
        # Many names, one that bends to anything beside another, and what holds hardly more than half of a
        # gap, are an explanation but not the only one.
        return replace(answer, verdict="ambiguous") if unsure else answer
    if len(answer.named.terms) <= FEW_NAMES and not little:
        return Answer("named_with_remainder", answer.named, True, coordinate)
    return owned


def hold_little(field: Closing, heading: Closing) -> bool:
    """Tell whether what is named holds less than six tenths of what lay above the floor."""
    explained = [
        (c.nominal**2 - c.after**2) / max(c.nominal**2 - c.floor**2, 1e-12)
        for c in (field, heading)
        if _above(c.nominal, c.floor)
    ]
    return min(explained, default=1.0) < 1.0 - _REMAINDER_UNTRUSTED


def owning_up(
    answer: Answer,
    decided: Answer,
    identified: Identified,
    field: Closing,
    adequacy: Adequacy,
    rest_at_floor: bool,
    unexplained: str = "",
) -> Answer:
    """Return an answer that is neither silent nor sure beside what healthy vehicles do not leave.

    For vehicles with a baseline, whose floor is known but not in detail. Names that bend what is known of
    vehicle and place are an explanation, but not the only one; nor are those that follow anything where the
    field without them comes to the floor, or the rest does, fitted alone (`rest_at_floor`). Where silence
    would leave what is loud, and the names that were `decided` do not, they stand: a magnet that is passed
    once hardly lifts the field's mean. Where it bends the known farther than chance does, they are one
    explanation, but not the only one. Structure along one coordinate is no silence either, however small,
    nor is what single readings show and no name is for: `unexplained` is its coordinate. But where silence
    leaves nothing loud and bends nothing, what a calibration may be off by is no name if it gains little.
    """
    problem, none = identified.problem, identified.problem.null()
    nothing = whitened_left(identified, none)
    loud = min(nothing) > _LOUD or nothing[0] > _LOUD_FITTED
    bent = problem.chance_of_strain(none) < _BENT_UNNAMED
    explained = answer.verdict in ("named", "ambiguous") and bool(answer.named.terms)
    # In sigmas of what the noise is seen to be: a baseline may scatter more than the flight.
    gained = (none.sse - answer.named.sse) / min(nothing[0], 1.0)
    of_calibration = all(term.effect.affine for term in answer.named.terms)
    if explained and of_calibration and not (loud or bent) and gained < EVIDENT:
        return Answer("no_gap", none, False, None)
    if answer.verdict == "named" and answer.named.terms:
        low = rest_at_floor or not _above(field.nominal, field.floor)
        small = low and bool(answer.named.ids & _PLIANT)
        if small or problem.strain(answer.named) > _BENT:
            return replace(answer, verdict="ambiguous")
    if answer.verdict not in ("no_gap", "named"):
        return answer
    left = whitened_left(identified, answer.named) if answer.named.terms else nothing
    structured = _structured(adequacy, left)
    if answer.verdict == "no_gap":
        if loud or bent:
            beside = whitened_left(identified, decided.named)
            quieter = beside[0] - 1.0 < _QUIETER * (left[0] - 1.0) or not loud
            if not decided.named.terms or not quieter or max(beside) >= _LOUD_BESIDE:
                return Answer("unknown", answer.named, True, adequacy.where)
            return decided if loud else replace(decided, verdict="ambiguous")
        sweeps = adequacy.sweeps and max(left) > _SCATTERS
        shows = "frequency" if sweeps else structured or unexplained
        return Answer("unknown", answer.named, True, shows) if shows else answer
    if min(left, default=0.0) > _LOUD_BESIDE:
        structured = adequacy.where
    return Answer("named_with_remainder", answer.named, True, structured) if structured else answer


def _structured(adequacy: Adequacy, left: Sequence[float]) -> str | None:
    """Return the coordinate along which what is left has more structure than healthy vehicles leave."""
    for test in sorted(adequacy.tests, key=lambda t: -t.excess):
        most = _STRUCTURED_ALONG if test.name in _ALONG else _STRUCTURED
        if test.excess > most * max((*left, 1.0)):
            return test.coordinate
    return None


def with_likely_names(
    answer: Answer, sets: Sequence[tuple[frozenset[str], float]], floor: Floor, none: Fit, traces: bool
) -> Answer:
    """Return an answer whose names beside a remainder are likely, each of them, or are taken back.

    `sets` are what could explain the gap, with their weights: beside something that nobody knows a name that
    may be another one is none.
    """
    if answer.verdict != "named_with_remainder" or floor.representative:
        return answer
    if all(held_by(effect, sets) >= _HELD for effect in answer.named.ids):
        return answer
    return Answer("named_with_remainder" if traces else "unknown", none, True, answer.coordinate)


def _unsure(named: Fit, floor: Floor, replay: Replay, traces: bool) -> bool:
    """Tell whether names that reach the floor are an explanation, but not the only one.

    Many names are, and one that bends to anything, beside another or without a baseline; so is what passes: a
    thing nearby that comes or goes, an iron that comes and goes again; a turn of the mounting where nothing
    fixes the yaw; and a line at half the sampling rate, where a sensor that sets and resets alternates.
    """
    alone = not floor.measured and replay.reference.kind != "columns"
    many = len(named.terms) > FEW_NAMES or (alone and traces and bool(named.terms))
    pliant = bool(named.ids & _PLIANT) and (alone or len(named.terms) > 1)
    passes = any(len(moments(named, effect)) > most for effect, most in _STAYING.items())
    turned = alone and replay.reference.yaw_unknown and bool(named.ids & _TURNS)
    step_s = float(np.median(np.diff(replay.time_s)))
    fastest = _NEARLY_ALTERNATING * 0.5 / step_s
    alternates = LINE in named.ids and line_hz(named) > fastest
    return many or pliant or passes or turned or alternates


def line_hz(named: Fit) -> float:
    """Return the frequency of a named line."""
    effect = next(term.effect for term in named.terms if term.effect.id == LINE)
    return float(named.theta(LINE)[effect.names.index("frequency_hz")])


def _above(value: float, floor: float) -> bool:
    return value > ABOVE * floor


def wanders(identified: Identified) -> bool:
    """Tell whether a wandering offset explains the gap better than the named effects do.

    It may stand beside any explored set that is smaller than the best one.
    """
    best, problem = identified.found.best, identified.first
    criteria = identified.search.on(problem).criteria
    own = criteria.score(best)
    rivals = [f for f in identified.found.explored.values() if len(f.terms) <= len(best.terms)]
    rivals = sorted({f.ids: f for f in [*rivals, best]}.values(), key=criteria.score)[:_DRIFT_RIVALS]
    cost = criteria.cost(1)
    for fit in rivals:
        gain, size = drift_gain(problem, fit)
        if size > 0.0 and gain > least_gain(4) and criteria.score(fit) - gain + cost < own - _DRIFT_MARGIN:
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
