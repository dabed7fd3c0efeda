"""Decide what is said of a recording: the best set, how probable it is, and what else it may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavcompass.gap.answer.evidence import Evidence, above, figures, statistics, yaw_wander_deg
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.result import Closing, Verdict
from mavcompass.gap.tables import Outcome, tables

Sets = tuple[tuple[frozenset[str], float], ...]


def verdict(
    outcomes: Mapping[Outcome, float], sure: float, *, silent: bool, left: bool, shared: bool, testable: bool
) -> Verdict:
    """Decide what is said: equation (3) of docs/gap.md.

    `outcomes` are what the best set may be, `sure` the probability that names it. `silent`: no single
    readings show anything, and no set what healthy vehicles do not; `testable`: silence would tell something.
    `left`: what is left lies above the floor, or is what healthy vehicles seldom leave. `shared`: something
    else than the catalogue's effect makes the same.
    """
    if silent:
        return "unknown" if left else "no_gap" if testable else "not_testable"
    whole, part, other, unknown = (outcomes[one] for one in ("whole", "part", "other", "unknown"))
    if unknown > max(whole + part, other):
        return "unknown"
    if whole >= sure and not (left or shared):
        return "named"
    if left or part > max(whole, other):
        return "named_with_remainder" if whole + part > other + unknown else "unknown"
    return "ambiguous"


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Hold the verdict, the fit whose effects are named, what it closes, and every set that may be the cause.

    `sets` are without what single readings tell; `wander_deg` is how far an unwitnessed yaw has to wander.
    """

    verdict: Verdict
    named: Fit
    field: Closing
    heading: Closing
    sets: Sets
    coordinate: str | None = None
    wander_deg: float = 0.0

    @property
    def flagged(self) -> bool:
        """Tell whether something is left that nothing known explains."""
        return self.verdict in ("unknown", "named_with_remainder")


def decide(evidence: Evidence) -> Answer:
    """Decide what is said."""
    identified, floor, table = evidence.identified, evidence.floor, tables()
    posterior, none, fit = identified.posterior, identified.null, identified.fit
    field, heading = figures(evidence, fit, with_scatter=True)
    if evidence.frozen:
        return Answer("named_with_remainder", none, field, heading, (), evidence.goodness.where)
    known, levels = statistics(evidence, field, heading), table.levels
    outcomes = table.map.probabilities(known.values)
    alone = figures(evidence, none, with_scatter=False)
    # Something lies above a floor without the set, or what it was not fitted to gains: other readings, and
    # what is known of vehicle and place.
    relieved = posterior.nothing.mahalanobis2 - posterior.best.mahalanobis2
    confirmed = known.held_out_gain + relieved > 0.0 or any(c.nominal > c.floor for c in alone)
    healthy = table.healthy.p_of_gain(known.gain) > levels.gain
    silent = not evidence.beside_ids and (not fit.terms or healthy or not confirmed)
    # Names beside a yaw that has to wander are borne out by no heading.
    wander_deg = 0.0 if silent else yaw_wander_deg(identified.problem, fit, floor, heading)
    if silent:
        field, heading = alone
    # What single readings show and no name is for is no silence.
    shown = silent and bool(evidence.detected.unexplained)
    turns = bool(evidence.replay.present & {"turning", "tilt"}) or floor.measured
    # An exact floor is judged in detail instead.
    lifted = known.kind != "exact" and any(above(c, c.after) for c in (field, heading))
    seldom = table.healthy.p_of_fit(known.kind, known.values) <= levels.fit
    said = verdict(
        outcomes,
        levels.sure,
        silent=silent,
        left=shown or wander_deg > 0.0 or lifted or seldom,
        shared=bool(fit.ids & evidence.half_testable),
        testable=turns and (floor.measured or heading.floor < levels.coarsest_deg),
    )
    known_sets = ((fit.ids, outcomes["whole"] + outcomes["part"]), *posterior.weights(outcomes["other"]))
    where = evidence.goodness.where if said in ("unknown", "named_with_remainder") else None
    if said in ("named", "ambiguous", "named_with_remainder"):
        return Answer(said, fit, field, heading, _ambiguity_set(known_sets), where, wander_deg)
    if said == "unknown" and (evidence.faults or evidence.detected.causes):
        # What single readings show by themselves is named, whatever else there is.
        both = figures(evidence, none, with_scatter=True)
        sets = ((none.ids, 1.0 - outcomes["unknown"]),)
        return Answer("named_with_remainder", none, *both, sets, where)
    return Answer(said, none, *alone, _ambiguity_set([one for one in known_sets if one[0]]), where)


def _ambiguity_set(sets: Sequence[tuple[frozenset[str], float]]) -> Sets:
    """Return the smallest set of sets that holds as much of what all of them do as is told, the likeliest
    first."""
    least, held, out = tables().levels.held * sum(weight for _, weight in sets), 0.0, []
    for ids, weight in sorted(sets, key=lambda one: -one[1]):
        if held >= least:
            break
        out.append((ids, weight))
        held += weight
    return tuple(out)
