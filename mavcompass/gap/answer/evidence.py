"""What was found about one recording, and the figures by which it is judged: how far the gap closes.

The closing is measured on held-out rows, with the named effects in the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mavcompass.chance import students_t
from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.detect import Detected
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import REFERENCE_YAW
from mavcompass.gap.residual.floor import Floor, heading_error_rad, heading_scatter, kind_of, rms
from mavcompass.gap.residual.goodness_of_fit import GoodnessOfFit
from mavcompass.gap.result import Bar, Cause, Closing
from mavcompass.gap.selection.identification import Identified, Residual
from mavcompass.gap.tables import Kind, tables, usual
from mavcompass.simulation.effects.effect import LIMIT
from mavcompass.track import Track

# A lead over no rival at all.
_ALONE = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Hold all that was found about one recording.

    `untestable` says of effects why the recording cannot show them; of those that are `half_testable` it
    shows a part only.
    """

    track: Track
    compass: int
    replay: Replay
    floor: Floor
    identified: Identified
    remainder: Residual
    goodness: GoodnessOfFit
    detected: Detected
    untestable: dict[str, str]
    half_testable: frozenset[str]
    withheld: frozenset[str]
    faults: tuple[Cause, ...]

    @property
    def beside_ids(self) -> frozenset[str]:
        """Return what is named besides the fitted effects: faults, scatter, what single readings show."""
        scatter = self.remainder.scatter
        ids = {cause.effect for cause in (*self.faults, *self.detected.causes)}
        return frozenset(ids if scatter is None else ids | {scatter.effect})

    @property
    def frozen(self) -> bool:
        """Tell whether the compass says one thing throughout, and so tells of nothing else."""
        return self.detected.stale_share > 0.0 and self.replay.trace.frozen

    @property
    def unseen_mgauss2(self) -> float:
        """Return the variance of the readings that averaged and cleaned rows do not have."""
        scatter = self.remainder.scatter
        unseen = sum(rapid.variance_mgauss2 for rapid in self.detected.rapid)
        if scatter is not None and scatter.white:
            unseen += scatter.size**2 - scatter.on_rows_mgauss2(self.replay)
        return unseen


@dataclass(frozen=True, slots=True)
class Statistics:
    """Hold the statistics of a recording by name, and the population that they belong to.

    `gain` is that of the best set over none, `held_out_gain` that of readings that were not fitted.
    """

    kind: Kind
    gain: float
    held_out_gain: float
    values: dict[str, float]


def statistics(evidence: Evidence, field: Closing, heading: Closing) -> Statistics:
    """Collect them for the best set, whose closing is given.

    Logarithms of ratios that are one when all is well: `residual` and `held_out` are reduced chi squares
    of all readings and of those that were not fitted, `structure` the largest of a smooth test over that,
    `field` and `heading` what is left over the floor. Where the floor is exact, `unlikely` is how far the
    least p value of the tests lies from one.
    """
    identified, posterior = evidence.identified, evidence.identified.posterior
    problem, best, none = identified.first, posterior.best.fit, posterior.nothing.fit
    held = problem.with_rows(identified.split.test)
    spread, kind = posterior.overdispersion, kind_of(evidence.replay, evidence.floor)
    remainder = evidence.remainder
    residual = _reduced(remainder.problem, remainder.fit)
    tests = evidence.goodness.tests
    improbable = math.log1p(-math.log10(max(min((test.p for test in tests), default=1.0), 1e-300)))
    gained = (held.squares(none) - held.squares(best)) / spread
    values = {
        "lead": math.log1p(min(posterior.lead, _ALONE)),
        "residual": math.log(residual),
        "fitted": math.log(_reduced(problem, best)),
        "held_out": math.log(_reduced(held, best)),
        "structure": math.log(max((t.excess for t in tests), default=1.0) / max(residual, 1.0)),
        "unlikely": improbable if kind == "exact" else 0.0,
        "strain": math.log1p(posterior.best.mahalanobis2),
        "confirmed": math.copysign(math.log1p(abs(gained)), gained),
        "field": math.log(max(field.after, 1e-3) / field.floor),
        "heading": math.log(max(heading.after, 1e-3) / heading.floor),
        "members": float(len(best.terms)),
        "exact": float(kind == "exact"),
        "alone": float(kind in ("alone", "reference")),
    }
    return Statistics(kind, posterior.gain, gained, values)


def _reduced(problem: Problem, fit: Fit) -> float:
    """Return the mean square of whitened readings that a fit leaves; one where there are none."""
    size = 3 * len(problem.groups) * problem.count
    return max(problem.squares(fit) / size, 1e-3) if size else 1.0


def figures(evidence: Evidence, named: Fit, with_scatter: bool) -> tuple[Closing, Closing]:
    """Measure field and heading on held-out rows with the named effects, and with scatter if that is named.

    The variance that scatter adds to what the simulator makes of the rows, and what named effects add to
    single readings and rows do not have, are explained. Coarse numbers are compared as they may have been
    before they were rounded, which a simulator does, too.
    """
    identified, remainder, floor = evidence.identified, evidence.remainder, evidence.floor
    problem, rows = identified.problem, np.flatnonzero(identified.split.test)
    replay, scatter, unseen2 = problem.replay, remainder.scatter, evidence.unseen_mgauss2
    measured = told = replay.measured.mag_mgauss
    if evidence.detected.step_mgauss > 0.0:
        told = remainder.problem.replay.measured.mag_mgauss
        if named.ids == remainder.fit.ids:
            # What readings may have been before they were rounded was drawn about the fit to all of them.
            named = remainder.fit
    nominal, after = (problem.predict(named, effects).mag_mgauss for effects in (False, True))
    added2 = 0.0
    if scatter is not None and with_scatter:
        change = np.gradient(problem.signals(named).reading.mag_mgauss, replay.time_s, axis=0)[rows]
        late2 = float(np.mean((scatter.size * change) ** 2))
        added2 = scatter.on_rows_mgauss2(replay) if scatter.white else late2
    # A reading at the limit of a saturated sensor has no scatter of its own.
    limit, free = named.value(LIMIT), 1.0
    if limit is not None and rows.size:
        free = math.sqrt(float(np.mean(np.abs(measured[rows]) < usual.shrink.at_the_limit * limit)))
    step_s = max(usual.shrink.block_s, 10.0 * float(np.median(np.diff(replay.time_s))))
    block = np.floor((replay.time_s[rows] - replay.time_s[rows[:1]]) / step_s).astype(np.int64)
    field = _closing(
        (measured - nominal)[rows], (told - after)[rows], floor.field_rms_mgauss * free, added2, unseen2,
        floor.error_mgauss * free, block,
    )  # fmt: skip
    turned = (heading_error_rad(replay, *pair) for pair in ((measured, nominal), (told, after)))
    before_deg, after_deg = (np.degrees(angle[rows])[:, None] for angle in turned)
    deg2 = math.degrees(rms(heading_scatter(replay, after)[rows])) ** 2
    heading = _closing(
        before_deg, after_deg, floor.heading_rms_deg, deg2 * added2, deg2 * unseen2, np.zeros((0, 1)), block
    )
    return field, heading


def above(closing: Closing, value: float) -> bool:
    """Tell whether a figure lies above its floor by more than that may be off."""
    return value > tables().levels.above * closing.floor


def shows(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects change held-out readings enough to be judged by them."""
    held = problem.with_rows(test)
    change = held.shift(held.predict(fit), held.predict(fit, effects=False))
    return float(np.sum(change**2)) > usual.shrink.silent


def yaw_wander_deg(problem: Problem, fit: Fit, floor: Floor, heading: Closing) -> float:
    """Return by how much a yaw that neither witness nor baseline tells has to wander beside a fit, rms over
    time; 0 where that is no more than the heading's floor."""
    reference = problem.replay.reference
    if reference.witnessed or floor.measured:
        return 0.0
    yaw = problem.values(fit).get(REFERENCE_YAW)
    wander = 0.0 if yaw is None else math.degrees(rms(reference.wander_rad(yaw[1:])[problem.usable]))
    return wander if above(heading, wander) else 0.0


def _closing(
    before: FloatArray,
    after: FloatArray,
    floor: float,
    added: float,
    unseen: float,
    floor_error: FloatArray,
    blocks: NDArray[np.int64],
) -> Closing:
    """Measure one figure; no change where effects that show elsewhere leave it as it was."""
    nominal2, after2 = float(np.mean(before**2)) + unseen, float(np.mean(after**2))
    # What is left beside named scatter is known no better than the scatter of so many readings allows.
    chance = usual.shrink.sigmas * math.sqrt(2.0 / max(after.size, 1)) * added
    after2 = max(after2 - added - chance, min(after2, floor**2)) if added else after2
    # Where less is left than the floor allows, the floor of this recording lies no higher.
    least = min(floor, math.sqrt(after2))
    excess = nominal2 - least**2
    shrink = 1.0 - (after2 - least**2) / excess if excess > 0.0 else 0.0
    low, high = _interval(before, after, added, unseen, least, floor_error * (least / floor), blocks)
    if after2 > nominal2:
        # All sensors together became better; one that has no part in it differs by its noise.
        after2, shrink = nominal2, 0.0
    # What is left may lie below the floor by chance: no more than all of the gap closes.
    return Closing(
        math.sqrt(nominal2), math.sqrt(after2), floor, min(shrink, 1.0), (min(low, 1.0), min(high, 1.0))
    )


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
    rng = np.random.default_rng(usual.shrink.seed)
    picks = rng.integers(count, size=(usual.shrink.resamples, count))
    size = np.bincount(label)[picks].sum(axis=1) * before.shape[1]
    nominal2, after2 = (
        np.bincount(label, (error**2).sum(axis=1))[picks].sum(axis=1) / size for error in (before, after)
    )
    floor2 = np.full(usual.shrink.resamples, floor**2)
    if len(floor_error) > 40:
        per = (floor_error**2).mean(axis=1)
        cells = per[: len(per) // 20 * 20].reshape(-1, 20).mean(axis=1)
        floor2 = cells[rng.integers(cells.size, size=(usual.shrink.resamples, cells.size))].mean(axis=1)
    excess = nominal2 + unseen - floor2
    gap = excess > 0.0
    if not gap.any():
        return (0.0, 0.0)
    values = 1.0 - (np.maximum(after2 - added, 0.0) - floor2)[gap] / excess[gap]
    low, high = np.quantile(values, [0.025, 0.975])
    # Few blocks scatter less among their resamples than they do themselves: Student's t for the normal.
    middle = float(np.median(values))
    wider = students_t(0.975, count - 1) / 1.959964 * math.sqrt(count / (count - 1.0))
    low, high = middle + wider * (float(low) - middle), middle + wider * (float(high) - middle)
    if not gap.mean() > 0.975:
        # So small a gap may be none at all: anything between nothing and everything may be closed.
        low, high = min(low, 0.0), max(high, 1.0)
    return max(low, -usual.shrink.farthest), min(high, 1.0 + usual.shrink.farthest)


def waterfall(problem: Problem, named: Fit, test: NDArray[np.bool_]) -> tuple[Bar, ...]:
    """Share the fall of the mean square on held-out rows among effects: Shapley's value and its range.

    Each effect is put right or left as the whole explanation has it; the range is over all orders.
    """
    places = range(len(named.terms))
    measured = problem.replay.measured.mag_mgauss[test]

    def left(chosen: Sequence[int]) -> float:
        terms, thetas = tuple(named.terms[at] for at in chosen), tuple(named.thetas[at] for at in chosen)
        partly = Fit(terms, thetas, named.nuisances)
        return rms(measured - problem.predict(partly).mag_mgauss[test]) ** 2

    value = {frozenset(c): left(c) for size in range(len(places) + 1) for c in combinations(places, size)}
    bars = []
    for place in places:
        parts = [(before, v - value[before | {place}]) for before, v in value.items() if place not in before]
        weighed = [part / math.comb(len(places) - 1, len(before)) for before, part in parts]
        sizes = [part for _, part in parts]
        whose = named.terms[place].effect.id
        bars.append(Bar(whose, sum(weighed) / len(places), (min(sizes), max(sizes))))
    return tuple(sorted(bars, key=lambda b: -b.part_mgauss2))
