"""How far the gap closes on held-out rows once the named effects are in the simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import students_t
from mavcompass.frames import FloatArray
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.floor import Floor, heading_error_rad, heading_scatter, rms
from mavcompass.gap.left.scatter import Scatter
from mavcompass.gap.replay.nuisance import REFERENCE_YAW
from mavcompass.gap.result import Bar, Closing
from mavcompass.simulation.effects.effect import LIMIT

# What lies above the floor by less may be the floor's own uncertainty.
ABOVE = 1.3
# Held-out readings that an effect changes by less than this (squared sigmas, in all) cannot judge it.
_SILENT = 9.0
_RESAMPLES = 1000
_BLOCK_S = 1.0
_SURE_SIGMAS = 2.0
# A shrink that may lie anywhere is not told farther than this beyond nothing and everything.
_FARTHEST = 1.0
_AT_THE_LIMIT = 1.0 - 1e-4
_SEED = 7


def figures(evidence: Evidence, named: Fit, with_scatter: bool) -> tuple[Closing, Closing]:
    """Measure field and heading with the named effects, and with scatter that was found if that is named."""
    identified, remainder = evidence.identified, evidence.remainder
    problem, test, scatter = identified.problem, identified.split.test, remainder.scatter
    added = 0.0
    if scatter is not None and with_scatter:
        added = _added_variance(scatter, problem, named, test)
    unrounded = None
    if evidence.traces.step_mgauss > 0.0:
        unrounded = remainder.problem.replay.measured.mag_mgauss
        if named.ids == remainder.fit.ids:
            # What readings may have been before they were rounded was drawn about the fit to all of them.
            named = remainder.fit
    both = closings(problem, named, test, evidence.floor, added, evidence.unseen_mgauss2, unrounded)
    return _never_worse(both[0]), _never_worse(both[1])


def above(closing: Closing, value: float) -> bool:
    """Tell whether a figure lies above its floor by more than that may be off."""
    return value > ABOVE * closing.floor


def shows(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects change held-out readings enough to be judged by them."""
    held = problem.with_rows(test)
    change = held.shift(held.predict(fit), held.predict(fit, effects=False))
    return float(np.sum(change**2)) > _SILENT


def yaw_wander_deg(problem: Problem, fit: Fit, floor: Floor, heading: Closing) -> float:
    """Return by how much a yaw that neither witness nor baseline tells has to wander beside a fit, rms over
    time; 0 where that is no more than the heading's floor."""
    reference = problem.replay.reference
    if reference.witnessed or floor.measured:
        return 0.0
    turned = [
        rms(reference.wander_rad(theta[1:])[problem.usable])
        for nuisance, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True)
        if nuisance.effect.id == REFERENCE_YAW
    ]
    wander = math.degrees(max(turned, default=0.0))
    return wander if wander > ABOVE * heading.floor else 0.0


def _never_worse(closing: Closing) -> Closing:
    """Say no change where effects that show elsewhere (accelerometer, gyro) leave one figure as it was.

    All sensors together became better; one that has no part in it differs by its noise.
    """
    if closing.after <= closing.nominal:
        return closing
    return replace(closing, after=closing.nominal, shrink=0.0)


def _added_variance(scatter: Scatter, problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> float:
    if scatter.white:
        return scatter.on_rows_mgauss2(problem.replay)
    field = problem.signals(fit).reading.mag_mgauss
    change = np.gradient(field, problem.replay.time_s, axis=0)[test]
    return float(np.mean((scatter.size * change) ** 2))


def closings(
    problem: Problem,
    fit: Fit,
    test: NDArray[np.bool_],
    floor: Floor,
    added_mgauss2: float = 0.0,
    unseen_mgauss2: float = 0.0,
    unrounded_mgauss: FloatArray | None = None,
) -> tuple[Closing, Closing]:
    """Measure field and heading on held-out rows: nominal, after, floor, shrink with its interval.

    `added_mgauss2` is the variance that a named scatter effect adds to what the simulator makes of the rows,
    `unseen_mgauss2` what named effects add to single readings, and rows do not have: it is all explained.
    `unrounded_mgauss` (N, 3) is what readings may have been before a simulator that rounds them, too.
    """
    measured = problem.replay.measured.mag_mgauss
    nominal, after = problem.predict(fit, effects=False), problem.predict(fit)
    before_field = measured - nominal.mag_mgauss
    told = measured if unrounded_mgauss is None else unrounded_mgauss
    after_field = told - after.mag_mgauss
    rows = np.flatnonzero(test)
    # A reading at the limit of a saturated sensor has no scatter of its own.
    free = _free_share(fit, measured[rows])
    field = _closing(
        before_field[rows], after_field[rows], floor.field_rms_mgauss * math.sqrt(free),
        added_mgauss2, unseen_mgauss2, floor.error_mgauss * math.sqrt(free), _blocks(problem, rows),
    )  # fmt: skip
    h0, h1 = (
        heading_error_rad(problem.replay, *pair)
        for pair in ((measured, nominal.mag_mgauss), (told, after.mag_mgauss))
    )
    deg2 = math.degrees(rms(heading_scatter(problem.replay, after.mag_mgauss)[rows])) ** 2
    heading = _closing(
        np.degrees(h0[rows])[:, None], np.degrees(h1[rows])[:, None], floor.heading_rms_deg,
        deg2 * added_mgauss2, deg2 * unseen_mgauss2, np.zeros((0, 1)), _blocks(problem, rows),
    )  # fmt: skip
    return field, heading


def _free_share(fit: Fit, measured: FloatArray) -> float:
    """Return the share of readings that are not at the limit of a saturated sensor."""
    limit = fit.value(LIMIT)
    if limit is None or not measured.size:
        return 1.0
    return float(np.mean(np.abs(measured) < _AT_THE_LIMIT * limit))


def _blocks(problem: Problem, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    time = problem.replay.time_s[rows]
    step = float(np.median(np.diff(problem.replay.time_s)))
    return np.floor((time - time[0]) / max(_BLOCK_S, 10.0 * step)).astype(np.int64) if rows.size else rows


def _closing(
    before: FloatArray,
    after: FloatArray,
    floor: float,
    added: float,
    unseen: float,
    floor_error: FloatArray,
    blocks: NDArray[np.int64],
) -> Closing:
    nominal2, after2 = float(np.mean(before**2)) + unseen, float(np.mean(after**2))
    # What is left beside named scatter is known no better than the scatter of so many readings allows.
    chance = _SURE_SIGMAS * math.sqrt(2.0 / max(after.size, 1)) * added
    after2 = max(after2 - added - chance, min(after2, floor**2)) if added else after2
    # Where less is left than the floor allows, the floor of this recording lies no higher.
    least = min(floor, math.sqrt(after2))
    shrink = _shrink(nominal2, after2, least**2)
    interval = _interval(before, after, added, unseen, least, floor_error * (least / floor), blocks)
    # What is left may lie below the floor by chance: no more than all of the gap closes.
    shrink, interval = min(shrink, 1.0), (min(interval[0], 1.0), min(interval[1], 1.0))
    return Closing(math.sqrt(nominal2), math.sqrt(after2), floor, shrink, interval)


def _shrink(nominal2: float, after2: float, floor2: float) -> float:
    excess = nominal2 - floor2
    if excess <= 0.0:
        return 0.0
    return 1.0 - (after2 - floor2) / excess


def _interval(
    before: FloatArray,
    after: FloatArray,
    added: float,
    unseen: float,
    floor: float,
    floor_error: FloatArray,
    blocks: NDArray[np.int64],
) -> tuple[float, float]:
    """Resample blocks (the same before and after) and the floor's; take the middle 95 %."""
    _, label = np.unique(blocks, return_inverse=True)
    count = int(label.max()) + 1 if label.size else 0
    if count < 4:
        # So few tell nothing: none or all of it may be closed.
        return (0.0, 1.0)
    rng = np.random.default_rng(_SEED)
    size = np.bincount(label).astype(np.float64) * before.shape[1]
    sums0 = np.bincount(label, (before**2).sum(axis=1))
    sums1 = np.bincount(label, (after**2).sum(axis=1))
    picks = rng.integers(count, size=(_RESAMPLES, count))
    n = size[picks].sum(axis=1)
    nominal2 = sums0[picks].sum(axis=1) / n + unseen
    after2 = np.maximum(sums1[picks].sum(axis=1) / n - added, 0.0)
    floor2 = np.full(_RESAMPLES, floor**2)
    if len(floor_error) > 40:
        per = (floor_error**2).mean(axis=1)
        cells = per[: len(per) // 20 * 20].reshape(-1, 20).mean(axis=1)
        floor2 = cells[rng.integers(cells.size, size=(_RESAMPLES, cells.size))].mean(axis=1)
    excess = nominal2 - floor2
    gap = excess > 0.0
    if not gap.any():
        return (0.0, 0.0)
    values = 1.0 - (after2[gap] - floor2[gap]) / excess[gap]
    low, high = np.quantile(values, [0.025, 0.975]).tolist()
    # Few blocks scatter less among their resamples than they do themselves: Student's t for the normal.
    middle, widening = float(np.median(values)), _student(count) * math.sqrt(count / (count - 1.0))
    low, high = middle + widening * (low - middle), middle + widening * (high - middle)
    if not gap.mean() > 0.975:
        # So small a gap may be none at all: anything between nothing and everything may be closed.
        low, high = min(low, 0.0), max(high, 1.0)
    return max(float(low), -_FARTHEST), min(float(high), 1.0 + _FARTHEST)


def _student(count: int) -> float:
    """Return the 97.5 % point of Student's t with count - 1 degrees of freedom over that of the normal."""
    return students_t(0.975, count - 1) / 1.959964


def waterfall(
    refit: Callable[[frozenset[str]], Fit],
    problem: Problem,
    ids: frozenset[str],
    test: NDArray[np.bool_],
) -> tuple[Bar, ...]:
    """Share the fall of the mean square on held-out rows among effects: Shapley's value and its range.

    Every subset is fitted on the training rows; the range is over all orders of adding the effects.
    """
    members = sorted(ids)
    value: dict[frozenset[str], float] = {}
    measured = problem.replay.measured.mag_mgauss[test]
    full = refit(ids)
    value[frozenset()] = rms(measured - problem.predict(full, effects=False).mag_mgauss[test]) ** 2
    for size in range(1, len(members) + 1):
        for subset in combinations(members, size):
            fit = full if size == len(members) else refit(frozenset(subset))
            value[frozenset(subset)] = rms(measured - problem.predict(fit).mag_mgauss[test]) ** 2
    bars = []
    for member in members:
        others = [m for m in members if m != member]
        parts, total = [], 0.0
        for size in range(len(others) + 1):
            weight = 1.0 / (len(members) * math.comb(len(others), size))
            for subset in combinations(others, size):
                before = frozenset(subset)
                part = value[before] - value[before | {member}]
                total += weight * part
                parts.append(part)
        bars.append(Bar(member, total, min(parts), max(parts)))
    return tuple(sorted(bars, key=lambda b: -b.part_mgauss2))
