"""Put the answer together: how far the gap closes on held-out parts, what was named, what to do next."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.answer.advise import next_flights
from mavcompass.gap.answer.belief import beliefs
from mavcompass.gap.answer.cure import corrected_rms, cured_iron
from mavcompass.gap.answer.locate import where
from mavcompass.gap.answer.naming import named_causes, trace_causes
from mavcompass.gap.answer.picture import picture
from mavcompass.gap.answer.shrink import closings, waterfall
from mavcompass.gap.answer.verdict import (
    LINE,
    Answer,
    consistent,
    hold_little,
    keeps_step,
    line_hz,
    owning_up,
    with_likely_names,
)
from mavcompass.gap.fit import Fit, Problem, difference
from mavcompass.gap.left import Adequacy, Floor, Scatter
from mavcompass.gap.replay import Replay, level_mgauss
from mavcompass.gap.result import Bar, Cause, Closing, Diagnosis
from mavcompass.gap.selection import (
    ABOVE,
    SILENT,
    Identified,
    Remainder,
    at_floor,
    evident,
    lost_in_the_floor,
)
from mavcompass.gap.traces import Traces
from mavcompass.track import Track

_MOST_SHAPLEY = 4
_IN_STEP = (
    "The line keeps step with the way driven: a magnet on something that turns with the wheels would look "
    "the same. Record the vehicle at another speed."
)
_UNSEEN = "No held-out part shows what is named: its shrink is not measured. Record it again."


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Hold all that was found about one recording."""

    track: Track
    compass: int
    replay: Replay
    floor: Floor
    identified: Identified
    remainder: Remainder
    adequacy: Adequacy
    traces: Traces
    untestable: dict[str, str]
    withheld: frozenset[str]
    faults: tuple[Cause, ...]

    @property
    def beside(self) -> bool:
        """Tell whether something is named besides the fitted effects: faults, scatter, other traces."""
        return bool(self.faults) or self.remainder.scatter is not None or self.traces.named

    @property
    def unseen_mgauss2(self) -> float:
        """Return the variance of the readings that averaged and cleaned rows do not have."""
        scatter = self.remainder.scatter
        unseen = sum(rapid.variance_mgauss2 for rapid in self.traces.rapid)
        if scatter is not None and scatter.effect == "noise_excess":
            unseen += scatter.size**2 - scatter.on_rows_mgauss2(self.replay)
        return unseen


def describe(evidence: Evidence, answer: Answer) -> Diagnosis:
    """Measure the closing on held-out rows, and write everything down."""
    identified, floor, scatter = evidence.identified, evidence.floor, evidence.remainder.scatter
    problem, test = identified.problem, identified.split.test
    answer, field, heading = _closed(evidence, answer)
    named = answer.named
    in_step = answer.verdict == "named" and _in_step(evidence, named)
    if in_step:
        answer = replace(answer, verdict="ambiguous")
    # What single readings told, and nothing besides, is all of the explanation.
    told = answer.verdict.startswith("named") or in_step
    by_traces = evidence.beside and not named.terms and told
    sets = [(named.ids, 1.0)] if by_traces else _ambiguity_set(identified)
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
        sha256=hashlib.sha256(path.read_bytes()).hexdigest() if path and path.is_file() else None,
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
        field=field,
        heading=heading,
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
            *((_IN_STEP,) if in_step else ()),
            *((_UNSEEN,) if named.terms and not _told(problem, named, test) else ()),
            *(f"{e} was considered and dropped: {why}." for e, why in identified.dropped),
        ),
        corrected_rms_mgauss=corrected_rms(problem, named, test),
        in_force=cured_iron(problem, named, floor),
        beliefs=beliefs(identified, named, answer.verdict == "ambiguous"),
        picture=picture(problem, named, test),
    )


def _in_step(evidence: Evidence, named: Fit) -> bool:
    """Tell whether a named line is one of something that may turn as the vehicle drives."""
    lines_hz = [r.parameters["frequency_hz"] for r in evidence.traces.rapid if r.effect == LINE]
    if LINE in named.ids:
        lines_hz.append(line_hz(named))
    # What flies has nothing that turns with its way.
    drives = evidence.track.vehicle != "copter"
    return drives and any(keeps_step(evidence.replay, hertz) for hertz in lines_hz)


def _hidden(evidence: Evidence, named: Fit) -> dict[str, str]:
    """Say of iron that is not seen why it may be there all the same."""
    learnt = evidence.track.compasses[evidence.compass].less_learnt and "hard_iron" not in named.ids
    return {"hard_iron": "PX4's HIGHRES_IMU is less what its estimator learns of it"} if learnt else {}


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


def _closed(evidence: Evidence, answer: Answer) -> tuple[Answer, Closing, Closing]:
    """Measure the closing; take a name back that makes held-out readings worse."""
    identified, floor, scatter = evidence.identified, evidence.floor, evidence.remainder.scatter
    problem, test = identified.problem, identified.split.test
    added, unrounded = 0.0, None
    if scatter is not None and answer.verdict != "unknown":
        added = _added_variance(scatter, problem, answer.named, test)
    if evidence.traces.step_mgauss > 0.0:
        unrounded = evidence.remainder.problem.replay.measured.mag_mgauss
    explained = (added, evidence.unseen_mgauss2, unrounded)

    def closed(named: Fit) -> tuple[Closing, Closing]:
        # What readings may have been before they were rounded was drawn about the fit to all of them.
        drawn = unrounded is not None and named.ids == evidence.remainder.fit.ids
        return closings(problem, evidence.remainder.fit if drawn else named, test, floor, *explained)

    decided, with_names = answer, closed(answer.named)
    field, heading = with_names
    none = identified.found.null
    where_left = evidence.adequacy.where
    turns = bool(problem.replay.present & {"turning", "tilt"}) or floor.measured
    # Of another iron only what shrinks is a cause: a calibration may be off by it.
    others = any(not term.effect.affine for term in answer.named.terms)
    shrunk = field.after < field.nominal
    certain = others and shrunk and evident(replace(identified, fit=answer.named), none)
    # Beside the best explanation of the rest a constant offset of what hardly turns is none.
    varies = not (turns or at_floor(identified, none, floor, ABOVE))
    stated = (where_left, floor, none, evidence.beside, turns, problem.replay)
    weighed = (certain, not evidence.faults, varies)
    below = floor.measured and not (floor.representative or evidence.beside)
    below = below and all(c.nominal < c.floor for c in (field, heading))
    if below and lost_in_the_floor(problem, answer.named, floor):
        # Whatever single readings know.
        said = Answer("no_gap", none, False, None)
    else:
        said = consistent(answer, field, heading, *stated, *weighed)
    if said.verdict == "no_gap" and answer.named.terms:
        # Beside the best explanation of the rest (place, calibration, attitude) nothing lies above the floor.
        field, heading = (replace(c, after=c.nominal, shrink=0.0) for c in (field, heading))
    elif said.named is not answer.named:
        # Without its names an answer has other figures, which it must not contradict either.
        field, heading = closed(said.named)
        said = consistent(said, field, heading, *stated, *weighed)
    answer = said
    by_scatter = scatter is not None and not (evidence.faults or evidence.traces.named)
    alone = by_scatter and answer.verdict == "named_with_remainder" and not answer.named.terms
    if alone and not floor.measured and hold_little(field, heading):
        # What nobody knows scatters, too: without a baseline that is no cause of it.
        answer = Answer("unknown", none, True, answer.coordinate)
        field, heading = closings(problem, none, test, floor)
    if floor.measured and not floor.representative and not evidence.beside:
        quiet = at_floor(identified, none, floor, ABOVE)
        answer = owning_up(said, decided, identified, field, evidence.adequacy, quiet)
        if answer is decided:
            field, heading = with_names
    if answer.named.terms and _worse_on(problem, answer.named, test):
        # A name that makes held-out data worse is no explanation.
        answer = Answer("unknown", none, True, where_left)
        field, heading = closings(problem, none, test, floor)
    likely = with_likely_names(answer, _ambiguity_set(identified), floor, none, evidence.beside)
    if likely is not answer:
        answer, (field, heading) = likely, closed(none)
    shrinks = floor.representative or any(c.shrink_ci95[0] > 0.0 for c in (field, heading))
    if answer.verdict == "named" and answer.named.terms and not (shrinks or evidence.beside):
        # What is certain by its shape alone, and does not surely shrink the mean, may be something else.
        answer = replace(answer, verdict="ambiguous")
    return answer, _never_worse(field), _never_worse(heading)


def _worse_on(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects make held-out readings of all sensors less likely."""
    held = problem.with_rows(test)
    before, after = held.residual(held.predict(fit, effects=False)), held.residual(held.predict(fit))
    return _told(problem, fit, test) and float(after @ after) > float(before @ before)


def _told(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> bool:
    """Tell whether the effects change held-out readings enough to be judged by them."""
    held = problem.with_rows(test)
    change = held.whitened([difference(held.predict(fit), held.predict(fit, effects=False))])
    return float(np.sum(change**2)) > SILENT


def _never_worse(closing: Closing) -> Closing:
    """Say no change where effects that show elsewhere (accelerometer, gyro) leave one figure as it was.

    All sensors together became better; one that has no part in it differs by its noise.
    """
    if closing.after <= closing.nominal:
        return closing
    return replace(closing, after=closing.nominal, shrink=0.0)


def _added_variance(scatter: Scatter, problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> float:
    if scatter.effect == "noise_excess":
        return scatter.on_rows_mgauss2(problem.replay)
    field = problem.signals(fit).reading.mag_mgauss
    change = np.gradient(field, problem.replay.time_s, axis=0)[test]
    return float(np.mean((scatter.size * change) ** 2))


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
