"""What the calibration in force already cures: listed without any search, and part of what a simulator
needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import MotorSource
from mavcompass.frames import FloatArray
from mavcompass.gap.floor import Floor, rms
from mavcompass.gap.hypothesis import Fit
from mavcompass.gap.in_force import IRON_MATRIX, IRON_OFFSET
from mavcompass.gap.model import Problem
from mavcompass.gap.nuisance import WORLD_FIELD


@dataclass(frozen=True, slots=True, eq=False)
class Cured:
    """Hold the vehicle's iron as its calibration, and its baseline, describe it: raw = A field + b + motor
    load.

    Attributes:
        calibrated: False where no calibration is in force.
        hard_iron_mgauss, matrix, motor_mgauss: b (3,), A (3, 3) and the field per unit of motor load (3,)
        that the
            calibration in force cures.
        tuned_hard_iron_mgauss, tuned_matrix, tuned_motor_mgauss: the same with what the recordings add to it.
        motor_source: the load that the motor term goes with.
        sigma_heading_deg: how far the calibration may be off, in heading.
    """

    calibrated: bool
    hard_iron_mgauss: FloatArray
    matrix: FloatArray
    motor_mgauss: FloatArray
    tuned_hard_iron_mgauss: FloatArray
    tuned_matrix: FloatArray
    tuned_motor_mgauss: FloatArray
    motor_source: MotorSource
    sigma_heading_deg: float

    def to_json(self) -> dict[str, object]:
        """Return the cures for machines."""
        return {
            "cures": {
                "hard_iron": self.hard_iron_mgauss.tolist(),
                "matrix": self.matrix.tolist(),
                "motor": self.motor_mgauss.tolist(),
            },
            "sigma_heading_deg": self.sigma_heading_deg,
        }

    def words(self) -> str | None:
        """Say in a line what the calibration cures; None where there is nothing to say."""
        if not self.calibrated:
            return None
        said = f"hard iron ({_listed(self.hard_iron_mgauss, 0)}) mG"
        if not np.allclose(self.matrix, np.eye(3), atol=1e-6):
            said += f", gains {_listed(np.diag(self.matrix), 3)}"
        if np.abs(self.motor_mgauss).max() > 0.0:
            unit = "mG per A" if self.motor_source == "current" else "mG at full throttle"
            said += f", motors ({_listed(self.motor_mgauss, 1)}) {unit}"
        return said


def _listed(values: FloatArray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values.tolist())


def cured_iron(problem: Problem, fit: Fit, floor: Floor) -> Cured:
    """Collect what the calibration in force cures, and what a fit found it to be."""
    iron = problem.replay.iron
    values = {n.effect.id: x for n, x in zip(problem.nuisances, fit.nuisance_thetas, strict=True)}
    change = values.get(IRON_MATRIX, np.zeros(9)).reshape(3, 3)
    offset = values.get(IRON_OFFSET, np.zeros(3))
    motor = offset[3:] if offset.size > 3 else np.zeros(3)
    level = max(float(np.hypot(*problem.replay.signals.stimulus.field_ned_mgauss[0][:2])), 1.0)
    total = float(np.linalg.norm(problem.replay.signals.stimulus.field_ned_mgauss[0]))
    trust = floor.trust
    doubted = np.zeros(12) if trust is None else iron.sigma(trust)
    sigma = math.hypot(rms(doubted[:3]), rms(doubted[3:]) * total) / level
    return Cured(
        calibrated=iron.calibrated,
        hard_iron_mgauss=iron.offset_mgauss,
        matrix=iron.matrix,
        motor_mgauss=iron.motor_mgauss,
        tuned_hard_iron_mgauss=iron.offset_mgauss + offset[:3],
        tuned_matrix=iron.matrix @ (np.eye(3) + change),
        tuned_motor_mgauss=iron.motor_mgauss + motor,
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
