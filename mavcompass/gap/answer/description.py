"""Put the answer together: how far the gap closes on held-out parts, what was named, what to do next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mavcompass.files import sha256_of
from mavcompass.gap.answer.advise import next_flights
from mavcompass.gap.answer.belief import beliefs, corrected_rms, cured_iron
from mavcompass.gap.answer.decision import Answer
from mavcompass.gap.answer.evidence import Evidence
from mavcompass.gap.answer.locate import picture, where
from mavcompass.gap.answer.naming import named_causes, trace_causes
from mavcompass.gap.answer.shrink import shows, waterfall
from mavcompass.gap.fit import Fit
from mavcompass.gap.replay import level_mgauss
from mavcompass.gap.result import Bar, Diagnosis
from mavcompass.gap.selection import Identified
from mavcompass.parameter_remarks import remarks_said
from mavcompass.simulation.effects import Stage, catalogue

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
    """Write everything down."""
    identified, floor, scatter = evidence.identified, evidence.floor, evidence.remainder.scatter
    problem, test, named = identified.problem, identified.split.test, answer.named
    weights = dict(answer.sets)
    beside = evidence.faults
    if answer.verdict != "unknown":
        beside = trace_causes(scatter, evidence.traces, level_mgauss(evidence.replay)) + beside
    # Whatever else is named, what single readings tell is there.
    beside = tuple(replace(cause, probability=sum(weights.values())) for cause in beside)
    causes = named_causes(identified, named, weights) + beside
    bars: tuple[Bar, ...] = ()
    if 1 <= len(named.terms) <= _MOST_SHAPLEY:
        bars = waterfall(lambda ids: _subset(identified, ids), problem, named.ids, test)
    rivals = [
        (e.fit.ids, e.fit)
        for e in (identified.posterior.best, *identified.posterior.rivals)
        if e.fit.ids in weights
    ]
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
        look_alikes=() if named.terms else named_causes(identified, identified.fit, weights),
        ambiguity_set=tuple(
            (tuple(sorted(ids.union(c.effect for c in beside))), w) for ids, w in answer.sets
        ),
        where=where(problem.with_rows(replayed.valid), named),
        field=answer.field,
        heading=answer.heading,
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
            *((_IN_STEP,) if answer.in_step else ()),
            *((_WANDERS.format(answer.wander_deg),) if answer.wander_deg else ()),
            *((_UNSEEN,) if named.terms and not shows(problem, named, test) else ()),
            *(_same(evidence) if named.terms else ()),
        ),
        corrected_rms_mgauss=corrected_rms(problem, named, test),
        in_force=cured_iron(problem, named, floor),
        beliefs=beliefs(identified, named, answer.sets if answer.verdict == "ambiguous" else ()),
        picture=picture(problem, named, test),
    )


def _same(evidence: Evidence) -> Iterator[str]:
    """Say which sets are the same as the named one to first order, in more words."""
    posterior = evidence.identified.posterior
    known = posterior.best.fit.ids
    for other in posterior.explanations[1:]:
        if posterior.restates(other) and not known < other.fit.ids:
            names, same = (" + ".join(sorted(ids)) for ids in (known, other.fit.ids))
            yield f"{names}; the same to first order: {same}."


def _hidden(evidence: Evidence, named: Fit) -> dict[str, str]:
    """Say of iron that is not seen why it may be there all the same."""
    if not evidence.track.compasses[evidence.compass].less_learnt:
        return {}
    offsets = {e.id for e in catalogue().values() if e.affine and e.stage is Stage.FIELD}
    return dict.fromkeys(offsets - named.ids, "PX4's HIGHRES_IMU is less what its estimator learns of it")


def _subset(identified: Identified, ids: frozenset[str]) -> Fit:
    fit = identified.fit
    if ids == fit.ids:
        return fit
    keep = [i for i, t in enumerate(fit.terms) if t.effect.id in ids]
    # What is not an effect stays as the whole explanation has it, so that steps add up from the nominal.
    steady = identified.problem.steady(fit)
    return steady.fit([fit.terms[i] for i in keep], [fit.thetas[i] for i in keep], fit.nuisance_thetas)
