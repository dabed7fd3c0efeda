"""What the calibration in force already cures: listed without any search, and part of what a simulator
needs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.fit import Fit, Problem
from mavcompass.gap.left import Floor, rms
from mavcompass.gap.replay import IRON_MATRIX, IRON_OFFSET, WORLD_FIELD, level_mgauss
from mavcompass.gap.result import Cured


def cured_iron(problem: Problem, fit: Fit, floor: Floor) -> Cured:
    """Collect what the calibration in force cures, and what a fit found it to be."""
    iron = problem.replay.iron
    values = {n.effect.id: x for n, x in zip(problem.nuisances, fit.nuisance_thetas, strict=True)}
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
