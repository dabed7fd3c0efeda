"""What was found about one recording before anything is said of it, and the figures by which it is judged."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.adequacy import Adequacy
from mavcompass.gap.left.floor import Floor, kind_of
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.result import Cause, Closing
from mavcompass.gap.selection.identification import Remainder
from mavcompass.gap.selection.posterior import Identified
from mavcompass.gap.tables import Kind
from mavcompass.gap.traces.traces import Traces
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
    remainder: Remainder
    adequacy: Adequacy
    traces: Traces
    untestable: dict[str, str]
    half_testable: frozenset[str]
    withheld: frozenset[str]
    faults: tuple[Cause, ...]

    @property
    def beside(self) -> bool:
        """Tell whether something is named besides the fitted effects: faults, scatter, other traces."""
        return bool(self.beside_ids)

    @property
    def beside_ids(self) -> frozenset[str]:
        """Return what is named besides the fitted effects."""
        scatter = self.remainder.scatter
        ids = {cause.effect for cause in (*self.faults, *self.traces.causes)}
        return frozenset(ids if scatter is None else ids | {scatter.effect})

    @property
    def frozen(self) -> bool:
        """Tell whether the compass says one thing throughout, and so tells of nothing else."""
        return self.traces.stale_share > 0.0 and self.replay.trace.frozen

    @property
    def unseen_mgauss2(self) -> float:
        """Return the variance of the readings that averaged and cleaned rows do not have."""
        scatter = self.remainder.scatter
        unseen = sum(rapid.variance_mgauss2 for rapid in self.traces.rapid)
        if scatter is not None and scatter.white:
            unseen += scatter.size**2 - scatter.on_rows_mgauss2(self.replay)
        return unseen


@dataclass(frozen=True, slots=True)
class Statistics:
    """Hold the statistics of a recording by name, and the population that they belong to.

    `gain` is that of the best set over none, `held_out_gain` that of readings that were not fitted; `found`
    tells whether there is anything to be named.
    """

    kind: Kind
    gain: float
    held_out_gain: float
    found: bool
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
    tests = evidence.adequacy.tests
    improbable = math.log1p(-math.log10(max(min((test.p for test in tests), default=1.0), 1e-300)))
    gained = (_squares(held, none) - _squares(held, best)) / spread
    values = {
        "lead": math.log1p(min(posterior.lead, _ALONE)),
        "residual": math.log(residual),
        "fitted": math.log(_reduced(problem, best)),
        "held_out": math.log(_reduced(held, best)),
        "structure": math.log(max((t.excess for t in tests), default=1.0) / max(residual, 1.0)),
        "unlikely": improbable if kind == "exact" else 0.0,
        "strain": math.log1p(posterior.best.strain),
        "confirmed": math.copysign(math.log1p(abs(gained)), gained),
        "field": math.log(max(field.after, 1e-3) / field.floor),
        "heading": math.log(max(heading.after, 1e-3) / heading.floor),
        "members": float(len(best.terms)),
        "exact": float(kind == "exact"),
        "alone": float(kind in ("alone", "reference")),
    }
    return Statistics(kind, posterior.gain, gained, bool(best.terms) or evidence.beside, values)


def _squares(problem: Problem, fit: Fit) -> float:
    return float(np.sum(problem.residual(problem.predict(fit)) ** 2)) if problem.count else 0.0


def _reduced(problem: Problem, fit: Fit) -> float:
    """Return the mean square of whitened readings that a fit leaves; one where there are none."""
    size = 3 * len(problem.groups) * problem.count
    return max(_squares(problem, fit) / size, 1e-3) if size else 1.0
