"""What is believed of vehicle and place: distributions, and the iron that a calibration cures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.floor import Floor, rms
from mavcompass.gap.replay.nominal import level_mgauss
from mavcompass.gap.replay.nuisance import IRON_MATRIX, IRON_OFFSET, WORLD_FIELD
from mavcompass.gap.result import EFFECTS, FIELD, MATRIX, MOTOR, OFFSET, Belief, Cured
from mavcompass.gap.selection.posterior import Identified

_PLACES = {WORLD_FIELD.id: FIELD, IRON_MATRIX: MATRIX, IRON_OFFSET: slice(OFFSET.start, MOTOR.stop)}
_LEAST_WEIGHT = 0.02


def beliefs(
    identified: Identified, named: Fit, sets: Sequence[tuple[frozenset[str], float]]
) -> tuple[Belief, ...]:
    """Return the answer as a distribution; of several `sets` each by its weight."""
    problem = identified.problem
    chosen = [(1.0, named)]
    if sets:
        explored = {e.fit.ids: e.fit for e in identified.posterior.explanations} | {named.ids: named}
        chosen = [(weight, explored[ids]) for ids, weight in sets if weight >= _LEAST_WEIGHT] or chosen
    total = sum(weight for weight, _ in chosen)
    return tuple(_belief(problem, weight / total, fit) for weight, fit in chosen)


def _belief(problem: Problem, weight: float, fit: Fit) -> Belief:
    values = [np.zeros(EFFECTS), *fit.thetas]
    starts = np.cumsum([0, *(v.size for v in values)])
    mean = np.concatenate(values)
    rows: list[int] = []  # of the mean, for each fitted parameter; -1 for those of other nuisances
    for nuisance, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True):
        place = _PLACES.get(nuisance.effect.id)
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
    from_usual = _from_no_load(mean.size, float(problem.replay.iron.load.mean()))
    return Belief(
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


def cured_iron(problem: Problem, fit: Fit, floor: Floor) -> Cured:
    """Collect what the calibration in force cures, and what a fit found it to be."""
    iron = problem.replay.iron
    values = problem.values(fit)
    change = values.get(IRON_MATRIX, np.zeros(9)).reshape(3, 3)
    offset = values.get(IRON_OFFSET, np.zeros(3))
    motor = offset[3:] if offset.size > 3 else np.zeros(3)
    taught = {n.effect.id: n.mean for n in problem.nuisances}
    there = taught.get(IRON_OFFSET, np.zeros(3))
    level = level_mgauss(problem.replay)
    total = float(np.linalg.norm(problem.replay.signals.stimulus.field_ned_mgauss[0]))
    trust = floor.trust
    doubted = np.zeros(12) if trust is None else iron.sigma(trust)
    # Beside a baseline without a calibration the nominal simulation has no iron: all is among the causes.
    known = IRON_OFFSET in values
    sigma = math.hypot(rms(doubted[:3]), rms(doubted[3:]) * total) / level
    return Cured(
        calibrated=iron.calibrated,
        hard_iron_mgauss=iron.offset_mgauss,
        matrix=iron.matrix,
        motor_mgauss=iron.motor_mgauss,
        tuned_hard_iron_mgauss=iron.offset_mgauss + offset[:3] if known else np.zeros(3),
        tuned_matrix=iron.matrix @ (np.eye(3) + change) if known else np.eye(3),
        tuned_motor_mgauss=iron.motor_mgauss + motor if known else np.zeros(3),
        taught_hard_iron_mgauss=there[:3],
        taught_matrix=taught.get(IRON_MATRIX, np.zeros(9)).reshape(3, 3),
        taught_motor_mgauss=there[3:] if there.size > 3 else np.zeros(3),
        motor_source=iron.source,
        sigma_heading_deg=math.degrees(sigma),
    )


def corrected_rms(problem: Problem, fit: Fit, rows: NDArray[np.bool_]) -> float | None:
    """Return the rms of corrected readings less the model's field, as the attitude turns it; None if not
    corrected."""
    replay = problem.replay
    if replay.corrected_mgauss is None:
        return None
    known = {WORLD_FIELD.id, IRON_MATRIX, IRON_OFFSET}
    plain = tuple(
        np.zeros_like(theta) if n.effect.id in known else theta
        for n, theta in zip(problem.nuisances, fit.nuisance_thetas, strict=True)
    )
    raw = problem.predict(Fit((), (), plain, np.inf)).mag_mgauss
    field = replay.iron.field(raw) if any(n.effect.id == IRON_OFFSET for n in problem.nuisances) else raw
    return rms((replay.corrected_mgauss - field)[rows])
