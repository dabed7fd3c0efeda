"""The whole iron of a vehicle: what its calibration cures, what the recording adds, and how surely."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.export.vehicle import affine_map
from mavcompass.gap.result import Belief, Diagnosis
from mavcompass.simulation.effects import Setting, get
from mavcompass.simulation.effects.effect import Effect, Memory, Rng, Signals, Stage

IRON_NAMES = (
    *(f"offset_{axis}" for axis in "xyz"),
    *(f"gain_{pair}" for pair in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *(f"motor_{axis}" for axis in "xyz"),
)
_GAINS = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
_STEP = 1e-4
_UNTOLD_MGAUSS_PER_A = 1e3
# How far the motors' field of a calibration may be off, as a share.
_CALIBRATED = 0.1


def iron_settings(
    matrix: FloatArray, offset_mgauss: FloatArray, motor_mgauss: FloatArray, load: FloatArray
) -> list[Setting]:
    """Make raw = matrix field + offset + load motor, `load` (N,), where a diagnosis has them in the chain."""

    def bent(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
        return signals.with_mag(signals.reading.mag_mgauss @ matrix.T)

    def moved(signals: Signals, theta: FloatArray, memory: Memory, rng: Rng) -> Signals:
        added = offset_mgauss + np.nan_to_num(load)[:, np.newaxis] * motor_mgauss
        return signals.with_mag(signals.reading.mag_mgauss + added)

    return [
        Setting(Effect("the vehicle's matrix", "", stage, (), forward, affine=True), np.zeros(0))
        for stage, forward in ((Stage.MATRIX, bent), (Stage.FIELD, moved))
    ]


def effects_in(belief: Belief, values: FloatArray) -> list[Setting]:
    """Return the effects of a belief with values (P,) in the order of its mean, inside their ranges."""
    out = []
    for effect, at in zip(map(get, belief.effects), belief.places, strict=True):
        theta = values[at : at + len(effect.parameters)]
        out.append(Setting(effect, np.clip(theta, effect.lower, effect.upper)))
    return out


def whole_iron(diagnosis: Diagnosis) -> tuple[FloatArray, FloatArray] | None:
    """Return what is known of a vehicle's iron, (12,) in the order of `IRON_NAMES`, and its covariance.

    raw = A field + offset + motor current, A symmetric; the likeliest explanation counts. None where the
    diagnosis believes nothing.
    """
    if not diagnosis.beliefs or diagnosis.in_force is None:
        return None
    belief, cured = max(diagnosis.beliefs, key=lambda b: b.weight), diagnosis.in_force
    by_current = cured.motor_source == "current"

    def whole(values: FloatArray) -> FloatArray:
        matrix = cured.matrix @ (np.eye(3) + values[3:12].reshape(3, 3))
        offset = cured.hard_iron_mgauss + values[12:15]
        motor = (cured.motor_mgauss + values[15:18]) * by_current
        effects = effects_in(belief, values)
        affine = [setting for setting in effects if setting.effect.affine]
        a, b = affine_map([*iron_settings(matrix, offset, np.zeros(3), np.zeros(4)), *affine])
        motor = sum((s.theta for s in effects if s.effect.id == "motor_current"), motor)
        return np.concatenate([b, (0.5 * (a + a.T))[_GAINS], motor])

    jacobian, here = np.zeros((len(IRON_NAMES), belief.mean.size)), whole(belief.mean)
    for place in np.flatnonzero(np.diag(belief.covariance)).tolist():
        step = _STEP * np.eye(belief.mean.size)[place]
        jacobian[:, place] = (whole(belief.mean + step) - here) / _STEP
    covariance = jacobian @ belief.covariance @ jacobian.T
    if not covariance[9:, 9:].any():
        covariance[9:, 9:] = _UNTOLD_MGAUSS_PER_A**2 * np.eye(3)
    size = float(np.linalg.norm(cured.motor_mgauss)) * by_current
    return _trusting(here, covariance, cured.motor_mgauss, _CALIBRATED * size) if size else (here, covariance)


def _trusting(
    values: FloatArray, covariance: FloatArray, motor_mgauss: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Take the motors' field of a calibration for a measurement.

    A diagnosis leaves open what its recording cannot exclude: far more than calibrations are wrong by.
    """
    gain = covariance[:, 9:] @ np.linalg.inv(covariance[9:, 9:] + sigma**2 * np.eye(3))
    return values + gain @ (motor_mgauss - values[9:]), covariance - gain @ covariance[9:, :]
