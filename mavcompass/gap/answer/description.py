"""Put the answer together: how far the gap closes, where it lies, what was named, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavcompass.files import sha256_of
from mavcompass.frames import FloatArray, matrix_to_euler
from mavcompass.gap.answer.advise import next_flights
from mavcompass.gap.answer.decision import Answer
from mavcompass.gap.answer.evidence import Evidence, shows, waterfall
from mavcompass.gap.answer.naming import named_causes
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import group_values
from mavcompass.gap.replay.nominal import level_mgauss
from mavcompass.gap.replay.nuisance import IRON_MATRIX, IRON_OFFSET, TELEMETRY_AGE, WORLD_FIELD
from mavcompass.gap.residual.floor import Floor, heading_error_rad, rms
from mavcompass.gap.result import (
    EFFECTS,
    FIELD,
    MATRIX,
    MOTOR,
    OFFSET,
    CalibrationInForce,
    Diagnosis,
    Iron,
    Picture,
    Place,
    PosteriorComponent,
)
from mavcompass.gap.selection.identification import Identified
from mavcompass.gap.tables import usual
from mavcompass.parameter_remarks import remarks_said
from mavcompass.simulation.effects import Stage, catalogue

_PLACES = {WORLD_FIELD.id: FIELD, IRON_MATRIX: MATRIX, IRON_OFFSET: slice(OFFSET.start, MOTOR.stop)}


def beliefs(
    identified: Identified, named: Fit, sets: Sequence[tuple[frozenset[str], float]]
) -> tuple[PosteriorComponent, ...]:
    """Return the answer as a distribution; of several `sets` each by its weight."""
    problem = identified.problem
    chosen = [(1.0, named)]
    if sets:
        explored = {e.fit.ids: e.fit for e in identified.posterior.explanations} | {named.ids: named}
        chosen = [(weight, explored[ids]) for ids, weight in sets if weight >= usual.report.weight] or chosen
    total = sum(weight for weight, _ in chosen)
    return tuple(_belief(problem, weight / total, fit) for weight, fit in chosen)


def _belief(problem: Problem, weight: float, fit: Fit) -> PosteriorComponent:
    values = [np.zeros(EFFECTS), *fit.thetas]
    starts = np.cumsum([0, *(v.size for v in values)])
    mean = np.concatenate(values)
    rows: list[int] = []  # of the mean, for each fitted parameter; -1 for those of other nuisances
    for nuisance, theta in problem.values(fit).items():
        place = _PLACES.get(nuisance)
        if place is None:
            rows += [-1] * theta.size
            continue
        rows += range(place.start, place.start + theta.size)
        mean[place.start : place.start + theta.size] = theta
    for term, start in zip(fit.terms, starts[1:], strict=False):
        rows += (start + np.flatnonzero(term.free)).tolist()
    covariance = np.zeros((mean.size, mean.size))
    kept = np.flatnonzero(np.array(rows, dtype=np.int64) >= 0)
    places = np.array(rows, dtype=np.int64)[kept]
    covariance[np.ix_(places, places)] = problem.lasting_covariance(fit)[np.ix_(kept, kept)]
    from_usual = _from_no_load(mean.size, problem.replay.iron.usual_load)
    return PosteriorComponent(
        weight,
        tuple(term.effect.id for term in fit.terms),
        tuple(starts[1:-1].tolist()),
        from_usual @ mean,
        from_usual @ covariance @ from_usual.T,
    )


def _from_no_load(size: int, usual_load: float) -> FloatArray:
    """Count the motors' field from no load on: the fit counts its doubt of it from the usual load on."""
    out = np.eye(size)
    out[OFFSET, MOTOR] = -usual_load * np.eye(3)
    return out


def cured_iron(problem: Problem, fit: Fit, floor: Floor) -> CalibrationInForce:
    """Collect what the calibration in force cures, and what a fit found it to be."""
    iron = problem.replay.iron
    values, taught = problem.values(fit), problem.values(Fit(nuisances=problem.prior.mean))
    more, there = (
        (known.get(IRON_MATRIX, np.zeros(9)), *_apart(known.get(IRON_OFFSET, np.zeros(3))))
        for known in (values, taught)
    )
    level = level_mgauss(problem.replay)
    total = float(np.linalg.norm(problem.replay.signals.stimulus.field_ned_mgauss[0]))
    trust = floor.trust
    doubted = np.zeros(12) if trust is None else iron.sigma(trust)
    sigma = math.hypot(rms(doubted[:3]), rms(doubted[3:]) * total) / level
    none = Iron(np.eye(3), np.zeros(3), np.zeros(3))
    return CalibrationInForce(
        calibrated=iron.calibrated,
        cures=iron,
        # Beside a baseline without a calibration the nominal simulation has no iron: all is among the causes.
        tuned=iron.changed(*more) if IRON_OFFSET in values else none,
        taught=Iron(there[0].reshape(3, 3), *there[1:]),
        motor_source=iron.source,
        sigma_heading_deg=math.degrees(sigma),
    )


def _apart(offset_mgauss: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Part what is not known of an offset from what is not known of the motors, if anything, (3,) each."""
    return offset_mgauss[:3], offset_mgauss[3:] if offset_mgauss.size > 3 else np.zeros(3)


def corrected_rms(problem: Problem, fit: Fit, rows: NDArray[np.bool_]) -> float | None:
    """Return the rms of corrected readings less the model's field, as the attitude turns it; None if not
    corrected."""
    replay = problem.replay
    if replay.corrected_mgauss is None:
        return None
    plain = np.where(problem.prior.holds(WORLD_FIELD.id, IRON_MATRIX, IRON_OFFSET), 0.0, fit.nuisances)
    raw = problem.predict(Fit(nuisances=plain)).mag_mgauss
    field = replay.iron.field(raw) if IRON_OFFSET in problem.prior.places else raw
    return rms((replay.corrected_mgauss - field)[rows])


_ALWAYS = {"time", "rate", "heading"}
_UNITS = {"current": "A", "throttle": "", "temperature": "degC"}
_WANDERS = (
    "The yaw of the attitude, which only the compass itself tells, has to wander by {:.0f} deg: field and "
    "dip were compared, but the heading hardly. A recording of the vehicle in a good state (--baseline) "
    "would tell."
)
_UNSEEN = "No held-out part shows what is named: its shrink is not measured. Record it again."


def coordinates(problem: Problem) -> dict[str, tuple[FloatArray, str]]:
    """Return the coordinates along which the recording varies: values (N,), and their unit."""
    s = problem.replay.signals.stimulus
    yaw = matrix_to_euler(s.rotation)[2]
    found: dict[str, tuple[FloatArray, str]] = {
        "heading": (np.degrees(yaw % (2.0 * math.pi)), "deg"),
        "tilt": (np.degrees(np.arccos(np.clip(s.rotation[:, 2, 2], -1.0, 1.0))), "deg"),
        "time": (s.time_s, "s"),
        "rate": (np.degrees(np.linalg.norm(s.rate_radps, axis=1)), "deg/s"),
    }
    found |= {name: (load, _UNITS[name]) for name, load in s.loads.items()}
    position = s.position_ned_m
    if np.isfinite(position).all():
        found["position"] = (np.linalg.norm(position - position.mean(axis=0), axis=1), "m from the middle")
    # What an effect of it could not be tested by tells nothing either: it mirrors something else.
    varied = problem.replay.present | _ALWAYS
    return {n: (v, u) for n, (v, u) in found.items() if n in varied and np.isfinite(v).all()}


def channels(problem: Problem, fit: Fit) -> dict[str, FloatArray]:
    """Return nominal residuals in units of the floor, by channel, (n,) on usable rows."""
    nominal = problem.predict(fit, effects=False)
    out: dict[str, FloatArray] = {}
    rows = problem.usable
    for group in problem.groups:
        error = group_values(problem.replay.measured, group) - group_values(nominal, group)
        for axis, letter in enumerate("xyz"):
            out[f"{group}_{letter}"] = error[rows, axis] / problem.noise[group].rms[axis]
    heading = heading_error_rad(problem.replay, problem.replay.measured.mag_mgauss, nominal.mag_mgauss)
    out["heading"] = heading[rows] * level_mgauss(problem.replay) / float(np.mean(problem.noise["mag"].rms))
    return out


def where(problem: Problem, fit: Fit) -> tuple[Place, ...]:
    """Rank (channel, coordinate): the share of the excess that binned means along the coordinate hold.

    The share is (between-bin sum of squares less its expectation) / (sum of squares less n), of all
    that exceeds the floor in the sensor's three channels. `frequency` is what no coordinate explains at
    low order: the share above a fifth of half the sampling rate.
    """
    rows = problem.usable
    residuals = channels(problem, fit)
    excess = {name: max(float(r @ r) - r.size, 0.0) for name, r in residuals.items()}
    sensors = {name.split("_")[0] for name in excess}
    total = {g: sum(e for name, e in excess.items() if name.split("_")[0] == g) for g in sensors}
    found = []
    for channel, residual in residuals.items():
        whole = total[channel.split("_")[0]]
        if whole <= 4.0 * math.sqrt(6.0 * residual.size) or excess[channel] <= 0.0:
            continue
        axis_share = excess[channel] / whole
        if channel != "heading":
            found.append(Place(channel, "axis", min(axis_share, 1.0), channel.split("_")[1]))
        for name, (values, unit) in coordinates(problem).items():
            share, at = _between(values[rows], residual, unit)
            found.append(Place(channel, name, float(np.clip(share / whole, 0.0, 1.0)), at))
        power = np.abs(np.fft.rfft(residual)) ** 2
        fast = power[power.size // 5 :].sum() / max(float(power[1:].sum()), 1e-12)
        part = max(float(fast) * float(residual @ residual) - 0.8 * residual.size, 0.0)
        found.append(Place(channel, "frequency", float(np.clip(part / whole, 0.0, 1.0)), "fast"))
    found.sort(key=lambda place: -place.share)
    return tuple(p for p in found if p.share > 0.02)[: usual.report.places]


def bin_means(values: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres, means and counts of the residual in bins of equal width along a coordinate."""
    edges = np.linspace(float(values.min()), float(values.max()) + 1e-9, usual.report.bins + 1)
    label = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, usual.report.bins - 1)
    count = np.bincount(label, minlength=usual.report.bins).astype(np.float64)
    mean = np.bincount(label, residual, minlength=usual.report.bins) / np.maximum(count, 1.0)
    return 0.5 * (edges[1:] + edges[:-1]), mean, count


def _between(values: FloatArray, residual: FloatArray, unit: str) -> tuple[float, str]:
    # A constant offset belongs to the axis, not to every coordinate.
    centres, mean, count = bin_means(values, residual - residual.mean())
    squares = count * mean**2
    used = int((count > 0).sum())
    top = int(np.argmax(np.where(count >= 5, np.abs(mean), 0.0)))
    return float(squares.sum()) - used, f"{centres[top]:.3g} {unit}".strip()


def picture(problem: Problem, fit: Fit, test: NDArray[np.bool_]) -> Picture:
    """Collect what the report draws."""
    replay = problem.replay
    before = replay.measured.mag_mgauss - problem.predict(fit, effects=False).mag_mgauss
    predicted = problem.predict(fit)
    return Picture(
        time_s=replay.time_s,
        valid=replay.valid,
        test=test,
        before_mgauss=before,
        after_mgauss=replay.measured.mag_mgauss - predicted.mag_mgauss,
        coordinates=coordinates(problem),
        innovations=problem.innovations(predicted)["mag"],
    )


def describe(evidence: Evidence, answer: Answer) -> Diagnosis:
    """Write everything down."""
    identified, floor, scatter = evidence.identified, evidence.floor, evidence.remainder.scatter
    problem, test, named = identified.problem, identified.split.test, answer.named
    weights = dict(answer.sets)
    beside = evidence.faults
    if answer.verdict != "unknown":
        level = level_mgauss(evidence.replay)
        read = (*(() if scatter is None else (scatter.cause,)), *evidence.detected.causes)
        read = tuple(replace(c, removes_deg=math.degrees(c.removes_mgauss / level)) for c in read)
        beside = read + beside
    # Whatever else is named, what single readings tell is there.
    beside = tuple(replace(cause, probability=sum(weights.values())) for cause in beside)
    causes = named_causes(identified, named, weights) + beside
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
        waterfall=waterfall(problem, named, test),
        unknown=answer.flagged,
        unknown_coordinate=answer.coordinate,
        tests=tuple((t.name, t.p) for t in evidence.goodness.tests[:12]),
        not_testable=tuple(sorted((_hidden(evidence, named) | evidence.untestable).items())),
        next_flight=next_flights(rivals, replayed.signals.stimulus.field_ned_mgauss[0], floor.noise),
        folded=floor.folded,
        withheld=tuple(sorted(evidence.withheld)),
        seconds=0.0,
        notes=(
            *problem.replay.notes,
            *remarks_said(evidence.track.autopilot, evidence.track.parameters, evidence.compass),
            *((_WANDERS.format(answer.wander_deg),) if answer.wander_deg else ()),
            *((_UNSEEN,) if named.terms and not shows(problem, named, test) else ()),
            *(_same(evidence) if named.terms else ()),
        ),
        late_s=_unusually_late_s(evidence, named),
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


def _unusually_late_s(evidence: Evidence, named: Fit) -> float | None:
    """Return how late readings come where that is beyond what is usual; None beside a baseline, which
    tells what is this vehicle's."""
    age = evidence.identified.problem.values(named).get(TELEMETRY_AGE)
    if age is None or evidence.floor.measured:
        return None
    late_s = float(age[0]) + evidence.replay.late_s
    return late_s if late_s > usual.age.usual_s + usual.age.unusual * usual.age.sigma_s else None


def _hidden(evidence: Evidence, named: Fit) -> dict[str, str]:
    """Say of iron that is not seen why it may be there all the same."""
    if not evidence.track.compasses[evidence.compass].less_learnt:
        return {}
    offsets = {e.id for e in catalogue().values() if e.affine and e.stage is Stage.FIELD}
    return dict.fromkeys(offsets - named.ids, "PX4's HIGHRES_IMU is less what its estimator learns of it")
