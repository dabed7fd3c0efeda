"""What an effect must remove to be named: of the gap, and of what healthy sensors do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import Floor, apart, heading_error_rad, rms
from mavcompass.gap.replay import group_values, level_mgauss
from mavcompass.gap.selection.identified import Identified
from mavcompass.gap.selection.levels import NEEDED_ABOVE, evident
from mavcompass.simulation.effects.effect import Group

# What healthy sensors may be off by, in mG, m/s^2 and rad/s.
_LEAST: dict[Group, float] = {"mag": 1.0, "acc": 0.1, "gyro": 0.004}
_LEAST_SHARE = 0.10
# The least that is named without an exact floor, in mG and degrees: with a baseline, and without.
_LEAST_HERE = {True: (0.5, 0.1), False: (1.0, 0.3)}
_LEAST_OF_FLOOR = 0.5
# Scatter, which means take out, hides no effect: without it a floor is no less than this share of itself.
_LASTING = 0.25
# No model is exact: what holds less than this share of a gap (4 % of its square) may be the error of the
# rest.
_MATERIAL_SHARE, _MATERIAL_BESIDE_UNKNOWN, _EXPLAINED = 0.2, 0.4, 1.25
_MATERIAL_IF_MISSED, _MISSED = 0.1, 1.4
# No simulation is exact to a twentieth of what it leaves: not even beside an exact floor.
_MODEL_SHARE = 0.05
_ABOVE_STATED, _LEAST_OF_STATED = 0.5, 0.1
# What is less than these shares of the floor, and of another effect, may be the error of that one.
_LOST_OF_FLOOR, _LOST_SHARE = 0.35, 0.06
# The least beside coarse numbers, as a share of what rounding leaves.
_LEAST_OF_ROUNDING = 0.5
# A block shows an effect where it changes this share of what it does where it changes most.
_TOUCHED = 0.05
# Rows that were not fitted speak for those that were where an effect changes these so much more, at most;
# where it is more still, they say nothing.
_MOST_UNSHOWN = 10.0
# Squared sigmas by which what is known of the vehicle may give way to a missing effect.
STRAINED = 30.0


def worthwhile(problem: Problem, floor: Floor, fit: Fit) -> bool:
    """Tell whether what a fit leaves above the noise is enough for one more effect to be named.

    What bends that which is known of vehicle and place has left it there.
    """
    if floor.representative or not problem.straight(fit):
        return True
    after = _left(problem, fit, effects=True)
    least = _least(problem, fit, after)
    noise: dict[Group, float] = {g: float(rms(problem.noise[g].rms)) for g in problem.groups}
    return any(after[g] ** 2 - noise[g] ** 2 > least[g] ** 2 for g in problem.groups)


def immaterial(candidate: Identified, floor: Floor) -> str | None:
    """Name the effect that is missed least of those that remove too little, without an exact floor.

    Where it was not fitted an effect must lower the error of the field or of the heading, by more than blocks
    contradict each other, and by a material share: of the gap, and of what healthy sensors leave. Beside an
    exact floor that is asked of effects on sensors which the baseline does not explain.
    """
    fit, problem = candidate.fit, candidate.problem
    doubtful = problem.replay.doubtful.keys()
    asked = [not floor.representative or bool(doubtful & set(t.effect.groups)) for t in fit.terms]
    if floor.representative:
        return _within_the_model(candidate, floor) or _too_small(candidate, floor, asked)
    gap = _gap(candidate, floor)
    # A floor that was only stated for an independent attitude is generous.
    stated = not floor.measured and problem.replay.reference.kind == "columns"
    needed, share = NEEDED_ABOVE[floor.measured], _LEAST_OF_FLOOR
    if stated:
        needed, share = _ABOVE_STATED, _LEAST_OF_STATED
    # Beside something that is not known, only what holds a good part of the gap can be told from it.
    left = rms((problem.replay.measured.mag_mgauss - problem.predict(fit).mag_mgauss)[problem.index])
    explained = stated or left < _EXPLAINED * floor.field_rms_mgauss
    part = _MATERIAL_SHARE if explained else _MATERIAL_BESIDE_UNKNOWN
    # Errors of rounding go with the field, as effects do; and no line is taken out without a rest.
    rounding = _LEAST_OF_ROUNDING * problem.replay.trace.step_mgauss / math.sqrt(12.0)
    inexact = max(rounding, _LOST_SHARE * problem.replay.taken_mgauss)
    lost = (inexact, _turned_by(problem, inexact))
    scatter = rms(problem.noise["mag"].sigma)
    scattered = (scatter, _turned_by(problem, scatter))
    lasting = [
        math.sqrt(max(gap[k][1] ** 2 - scattered[k] ** 2, (_LASTING * gap[k][1]) ** 2)) for k in (0, 1)
    ]

    def ratio(both: tuple[Removed, Removed], hides: Sequence[float], above: float) -> float:
        """Return what is removed over the least that must be, where more than `above` floors are left
        without it."""
        most = 0.0
        for k, removed in enumerate(both):
            change, level = gap[k]
            of_gap = part * change
            if not stated and removed.without > _MISSED * level:
                # What lies far above the floor without it is no error of the rest where it comes to the
                # floor with it, and where it is a good part of all that the rest leaves.
                unknown = max(_MATERIAL_SHARE * change, _MATERIAL_BESIDE_UNKNOWN * removed.without)
                of_gap = _MATERIAL_IF_MISSED * change if explained else min(of_gap, unknown)
            least = max(_LEAST_HERE[floor.measured][k], share * hides[k], of_gap, lost[k])
            if removed.sure > 0.0 and removed.without > above * level:
                most = max(most, math.sqrt(removed.square) / least)
        return most

    levels, costs = [level for _, level in gap], {}
    for place, term in enumerate(fit.terms):
        if "mag" not in term.effect.groups:
            continue
        both = removed_by(candidate, place)
        # Healthy vehicles may have another iron, by which a calibration is off, and nothing else.
        small = ratio(both, levels if term.effect.affine else lasting, needed) < 1.0
        if small and floor.measured and not term.effect.affine:
            # What is certain need not rise above the floor.
            known = evident(candidate, candidate.search.without(fit, term.effect.id))
            small = not known or ratio(both, [_LASTING * level for level in levels], 0.0) < 1.0
        if small:
            costs[term.effect.id] = both[0].cost
    # Of two that do the same the one that is missed least.
    return min(costs, key=costs.__getitem__, default=None)


def _within_the_model(candidate: Identified, floor: Floor) -> str | None:
    """Name an effect of the compass alone that changes it by less than a simulation may be off, whatever its
    readings know."""
    fit, problem = candidate.fit, candidate.problem
    whole = problem.predict(fit).mag_mgauss
    for place, term in enumerate(fit.terms):
        if term.effect.groups == ("mag",):
            change = rms((whole - problem.predict(fit.without(place)).mag_mgauss)[problem.index])
            if change < _MODEL_SHARE * floor.field_rms_mgauss:
                return term.effect.id
    return None


def _turned_by(problem: Problem, field_mgauss: float) -> float:
    """Return by how many degrees an error of the field turns the heading."""
    return math.degrees(field_mgauss / level_mgauss(problem.replay))


def _gap(candidate: Identified, floor: Floor) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return rms of what the effects change and of the floor, for field (mG) and heading (deg)."""
    fit, problem = candidate.fit, candidate.problem
    after, before = problem.predict(fit), problem.predict(_turned_alone(fit))
    field, heading = apart(problem.replay, after.mag_mgauss, before.mag_mgauss, problem.index)
    return (field, floor.field_rms_mgauss), (heading, floor.heading_rms_deg)


def _turned_alone(fit: Fit) -> Fit:
    """Return a fit with its turn of the mounting by right angles alone, which is exact: it hides nothing."""
    for place in reversed(range(len(fit.terms))):
        fit = fit if fit.terms[place].effect.kind == "discrete" else fit.without(place)
    return fit


@dataclass(frozen=True, slots=True)
class Removed:
    """Hold what an effect takes off a held-out mean square, and the rms that stays without it anywhere.

    `sure` is a bound of it that blocks of the whole recording leave above zero where they agree; `cost` is
    what a fit without the effect loses, in squared sigmas.
    """

    square: float
    sure: float
    without: float
    cost: float


def removed_by(candidate: Identified, place: int) -> tuple[Removed, Removed]:
    """Return what one effect takes off the held-out field (mG) and heading (deg)."""
    fit, problem = candidate.fit, candidate.problem
    replay, split = problem.replay, candidate.split
    measured = replay.measured.mag_mgauss
    rest = fit.without(place)
    without = problem.fit(rest.terms, rest.thetas, fit.nuisance_thetas, iterations=4)
    cost = without.sse - fit.sse
    strained = problem.strain(without) > problem.strain(fit) + STRAINED
    bent = problem.straight(fit) and not problem.straight(without)
    if strained or bent or replay.reference.kind == "columns":
        # Bent by force, what is known of the vehicle would imitate the effect: it stays.
        without = problem.steady(fit).fit(rest.terms, rest.thetas, fit.nuisance_thetas, iterations=3)
    rows = np.flatnonzero((split.train | split.test) & problem.usable)
    squares = []
    predictions = [problem.predict(one).mag_mgauss for one in (without, fit)]
    for predicted in predictions:
        heading = np.degrees(heading_error_rad(replay, measured, predicted))[rows]
        squares.append(np.stack([np.mean((measured - predicted)[rows] ** 2, axis=1), heading**2], axis=1))
    gained = squares[0] - squares[1]
    held = split.test[rows]
    label = np.unique(split.block[rows], return_inverse=True)[1]
    count = np.bincount(label)

    def by_block(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(label, values[:, k]) / count for k in (0, 1)], axis=1)

    blocks = by_block(gained)
    # Blocks that an effect leaves alone say nothing against it.
    turned = np.degrees(heading_error_rad(replay, predictions[0], predictions[1]))[rows]
    changed = np.stack([np.mean(np.square(predictions[1] - predictions[0])[rows], axis=1), turned**2], axis=1)
    changes = by_block(changed)
    touched = changes[:, 0] >= _TOUCHED * changes[:, 0].max()
    blocks, changes = blocks[touched], changes[touched]
    # They agree if each gains in proportion to what the effect changes there.
    mean = blocks.mean(axis=0)
    off = blocks - changes * mean / np.maximum(changes.mean(axis=0), 1e-12)
    spread = np.sqrt(np.mean(off**2, axis=0))
    low = mean - 1.7 * spread / math.sqrt(len(blocks) - 1) if len(blocks) > 2 else mean
    if not held.any():
        held = np.ones(rows.size, dtype=np.bool_)
    # What it changes, and what is left without it, may lie in rows that were fitted: there it is no less.
    there, everywhere = changed[held].mean(axis=0), changed.mean(axis=0)
    shown = np.maximum(everywhere / np.maximum(there, 1e-12), 1.0)
    taken = gained[held].mean(axis=0) * np.minimum(shown, _MOST_UNSHOWN)
    if len(blocks) > 2:
        # Where those held out show next to nothing, it is at least what all blocks agree on.
        taken = np.where(shown > _MOST_UNSHOWN, np.maximum(taken, low), taken)
    left = np.maximum(squares[0][held].mean(axis=0), squares[0].mean(axis=0))
    of_field, of_heading = (
        Removed(max(float(taken[k]), 0.0), float(low[k]), math.sqrt(float(left[k])), cost) for k in (0, 1)
    )
    return of_field, of_heading


def _too_small(candidate: Identified, floor: Floor, asked: Sequence[bool]) -> str | None:
    """Name an effect that removes too little beside an exact floor: of those `asked`, or beside others."""
    fit, problem = candidate.fit, candidate.problem
    named = [place for place, wanted in enumerate(asked) if wanted]
    beside = [p for p, term in enumerate(fit.terms) if len(fit.terms) > 1 and "mag" in term.effect.groups]
    if not named and not beside:
        return None
    after, steady = _left(problem, fit, effects=True), problem.steady(fit)
    removed: dict[int, dict[Group, float]] = {}
    for place in sorted({*named, *beside}):
        left = _left(problem, steady.refit(fit.without(place)), effects=True)
        removed[place] = {g: math.sqrt(max(left[g] ** 2 - after[g] ** 2, 0.0)) for g in problem.groups}
    small = _within_tolerance(candidate, after, {p: removed[p] for p in named})
    if small is None:
        small = _lost_beside(candidate, floor, {p: removed[p]["mag"] for p in beside})
    return None if small is None else fit.terms[small].effect.id


def _within_tolerance(
    candidate: Identified, after: dict[Group, float], removed: Mapping[int, dict[Group, float]]
) -> int | None:
    """Return the effect that removes least, where that is within a sensor's tolerance."""
    if not removed:
        return None
    fit, problem = candidate.fit, candidate.problem
    least = _least(problem, fit, after)
    ratios = {
        place: max(size / least[g] for g, size in sizes.items() if g in fit.terms[place].effect.groups)
        for place, sizes in removed.items()
    }
    smallest = min(ratios, key=ratios.__getitem__)
    return smallest if ratios[smallest] < 1.0 else None


def _lost_beside(candidate: Identified, floor: Floor, removed: Mapping[int, float]) -> int | None:
    """Return the effect that removes least beside others, where the errors of these may be as large.

    No model is exact: the order of two matrices, the place of a magnet leave some hundredths of what they
    explain. A turn of the mounting by right angles is.
    """
    if not removed:
        return None
    smallest = min(removed, key=removed.__getitem__)
    terms = candidate.fit.terms
    inexact = [size for p, size in removed.items() if p != smallest and terms[p].effect.kind != "discrete"]
    least = min(_LOST_OF_FLOOR * floor.field_rms_mgauss, _LOST_SHARE * max(inexact, default=0.0))
    return smallest if removed[smallest] < least else None


def _least(problem: Problem, fit: Fit, after: dict[Group, float]) -> dict[Group, float]:
    """Return the least that an effect must remove to be named without a baseline."""
    nominal = _left(problem, _turned_alone(fit), effects=True)["mag"]
    # Nuisances that make room for effects may leave more than there was.
    nominal = min(nominal, _left(problem, problem.null(), effects=False)["mag"])
    gap = math.sqrt(max(nominal**2 - after["mag"] ** 2, 0.0))
    return {**_LEAST, "mag": max(_LEAST["mag"], _LEAST_SHARE * gap)}


def _left(problem: Problem, fit: Fit, effects: bool) -> dict[Group, float]:
    """Return the rms of what is left in each sensor on the fitted rows."""
    predicted = problem.predict(fit, effects)
    return {
        g: rms((group_values(problem.replay.measured, g) - group_values(predicted, g))[problem.index])
        for g in problem.groups
    }
