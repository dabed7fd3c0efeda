"""Put the answer together: how far the gap closes on held-out parts, what was named, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mavcompass.files import sha256_of
from mavcompass.gap.answer.advise import next_flights
from mavcompass.gap.answer.belief import beliefs
from mavcompass.gap.answer.cure import corrected_rms, cured_iron
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.answer.locate import where
from mavcompass.gap.answer.naming import named_causes, trace_causes
from mavcompass.gap.answer.picture import picture
from mavcompass.gap.answer.settled import settled, shows, yaw_wander_deg
from mavcompass.gap.answer.shrink import waterfall
from mavcompass.gap.answer.verdict import Answer
from mavcompass.gap.fit import Fit
from mavcompass.gap.replay import level_mgauss
from mavcompass.gap.result import Bar, Diagnosis
from mavcompass.gap.selection import Identified
from mavcompass.gap.traces import follows_way, keeps_step
from mavcompass.parameter_remarks import remarks_said
from mavcompass.simulation.effects import Stage, catalogue
from mavcompass.simulation.effects.effect import FREQUENCY

_MOST_SHAPLEY = 4
_IN_STEP = (
    "The line keeps step with the way driven: a magnet on something that turns with the wheels would look "
    "the same. Record the vehicle at another speed."
)
_WANDERS = (
    "The yaw of the attitude, which only the compass itself tells, has to wander by {:.0f} deg: field and "
    "dip were compared, but the heading hardly. A recording of the vehicle in a good state (--baseline) "
    "would tell."
)
_UNSEEN = "No held-out part shows what is named: its shrink is not measured. Record it again."


def describe(evidence: Evidence, answer: Answer) -> Diagnosis:
    """Measure the closing on held-out rows, and write everything down."""
    identified, floor, scatter = evidence.identified, evidence.floor, evidence.remainder.scatter
    problem, test = identified.problem, identified.split.test
    likely = _ambiguity_set(identified)
    said = settled(evidence, answer, likely)
    answer, named = said.answer, said.answer.named
    wander_deg = yaw_wander_deg(problem, named, floor, said.heading)
    in_step = answer.verdict.startswith("named") and _in_step(evidence, named)
    if in_step and answer.verdict == "named":
        answer = replace(answer, verdict="ambiguous")
    # What single readings told, and nothing besides, is all of the explanation.
    told = answer.verdict.startswith("named") or in_step
    by_traces = evidence.beside and not named.terms and told
    sets = [(named.ids, 1.0)] if by_traces else likely
    beside = evidence.faults
    if answer.verdict != "unknown":
        beside = trace_causes(scatter, evidence.traces, level_mgauss(evidence.replay)) + beside
    causes = named_causes(identified, named, dict(sets)) + beside
    bars: tuple[Bar, ...] = ()
    if 1 <= len(named.terms) <= _MOST_SHAPLEY:
        bars = waterfall(lambda ids: _subset(identified, ids), problem, named.ids, test)
    rivals = _rivals(identified) if identified.found.best.terms else ()
    replayed, track = evidence.replay, evidence.track
    path = Path(track.source) if track.source else None
    return Diagnosis(
        path=track.source,
        sha256=sha256_of(path) if path and path.is_file() else None,
        duration_s=float(replayed.time_s[-1] - replayed.time_s[0]),
        samples=int(replayed.valid.sum()),
        autopilot=track.autopilot,
        compass=evidence.compass,
        reference=replayed.reference.kind,
        verdict=answer.verdict,
        causes=causes,
        look_alikes=() if named.terms else named_causes(identified, identified.fit, dict(sets)),
        ambiguity_set=tuple((tuple(sorted(ids.union(c.effect for c in beside))), w) for ids, w in sets),
        where=where(problem.with_rows(replayed.valid), named),
        field=said.field,
        heading=said.heading,
        waterfall=bars,
        unknown=answer.flagged,
        unknown_coordinate=answer.coordinate,
        tests=tuple((t.name, t.p) for t in evidence.adequacy.tests[:12]),
        not_testable=tuple(sorted((_hidden(evidence, named) | evidence.untestable).items())),
        next_flight=next_flights(rivals, replayed.signals.stimulus.field_ned_mgauss[0], floor.noise),
        folded=floor.folded,
        withheld=tuple(sorted(evidence.withheld)),
        seconds=0.0,
        notes=(
            *problem.replay.notes,
            *remarks_said(evidence.track.autopilot, evidence.track.parameters, evidence.compass),
            *((_IN_STEP,) if in_step else ()),
            *((_WANDERS.format(wander_deg),) if wander_deg else ()),
            *((_UNSEEN,) if named.terms and not shows(problem, named, test) else ()),
            *(f"{e} was considered and dropped: {why}." for e, why in identified.dropped),
        ),
        corrected_rms_mgauss=corrected_rms(problem, named, test),
        in_force=cured_iron(problem, named, floor),
        beliefs=beliefs(identified, named, answer.verdict == "ambiguous"),
        picture=picture(problem, named, test),
    )


def _in_step(evidence: Evidence, named: Fit) -> bool:
    """Tell whether a named line is one of something that may turn as the vehicle drives."""
    if evidence.track.vehicle == "copter":
        # What flies has nothing that turns with its way.
        return False
    replayed, taken = evidence.replay, [r for r in evidence.traces.rapid if FREQUENCY in r.parameters]
    lines_hz = [r.parameters[FREQUENCY] for r in taken]
    if (hertz := named.value(FREQUENCY)) is not None:
        lines_hz.append(hertz)
    return any(keeps_step(replayed, hertz) for hertz in lines_hz) or any(
        follows_way(replayed, r.change_mgauss, hertz) for r, hertz in zip(taken, lines_hz, strict=False)
    )


def _hidden(evidence: Evidence, named: Fit) -> dict[str, str]:
    """Say of iron that is not seen why it may be there all the same."""
    if not evidence.track.compasses[evidence.compass].less_learnt:
        return {}
    offsets = {e.id for e in catalogue().values() if e.affine and e.stage is Stage.FIELD}
    return dict.fromkeys(offsets - named.ids, "PX4's HIGHRES_IMU is less what its estimator learns of it")


def _ambiguity_set(identified: Identified) -> list[tuple[frozenset[str], float]]:
    """Return the sets that explain the gap, with their weights.

    Those that reach the floor as well share one, and what was found for sets with an effect that a guard
    refused.
    """
    weights = dict(identified.found.weights)
    alike = [ids for ids in (identified.fit.ids, *identified.as_good) if ids] if identified.as_good else []
    if alike:
        refused = dict(identified.dropped).keys() - identified.fit.ids
        kept = {ids: w for ids, w in weights.items() if ids not in alike and not ids & refused}
        each = max(1.0 - sum(kept.values()), 0.0) / len(alike)
        weights = {**dict.fromkeys(alike, each), **kept}
    return [(ids, weight) for ids, weight in weights.items() if ids]


def _subset(identified: Identified, ids: frozenset[str]) -> Fit:
    fit = identified.fit
    if ids == fit.ids:
        return fit
    keep = [i for i, t in enumerate(fit.terms) if t.effect.id in ids]
    # What is not an effect stays as the whole explanation has it, so that steps add up from the nominal.
    steady = identified.problem.steady(fit)
    return steady.fit([fit.terms[i] for i in keep], [fit.thetas[i] for i in keep], fit.nuisance_thetas)


def _rivals(identified: Identified) -> Sequence[tuple[frozenset[str], Fit]]:
    explored = identified.found.explored
    return [(ids, explored[ids]) for ids, _ in identified.found.weights if ids in explored and ids]
