"""One vehicle of a kind: its whole iron, parameters from what is believed, and what chance decides."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.calibration.cross_terms import CROSS_TERMS_BEFORE
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import IDENTITY
from mavcompass.frames import FloatArray
from mavcompass.gap.export.vehicle import affine_map
from mavcompass.gap.rehearsal.kind import Kind
from mavcompass.gap.replay.nuisance import KnownIron
from mavcompass.gap.result import MATRIX, MOTOR, OFFSET, Diagnosis, Iron, PosteriorComponent
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import Setting, get
from mavcompass.simulation.effects.effect import Distortion

IRON_NAMES = (
    *(f"offset_{axis}" for axis in "xyz"),
    *(f"gain_{pair}" for pair in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *(f"motor_{axis}" for axis in "xyz"),
)
_GAINS = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
_STEP = 1e-4
MOST_POSITIONS = 10
# Sources of error beside the effects; of motors what the recording leaves open of their field, beside
# what the calibration in force says of it.
NOISE, QUANTISATION, TILT, GYRO, FIELD, MOTORS = "noise", "quantisation", "tilt", "gyro", "field", "motors"
SOURCES = (NOISE, QUANTISATION, TILT, GYRO, FIELD, MOTORS)
# The horizontal cross term of the iron, and the vertical ones.
_CROSS = (((0, 1),), ((0, 2), (1, 2)))
# What scatters single readings or their times is in the vehicle's stances.
_ACTING = frozenset({"mean", "discrete"})


def iron_settings(iron: Iron, load: FloatArray) -> list[Setting]:
    """Make raw = A field + b + motor load, `load` (N,), where a diagnosis has them in the chain."""
    known = KnownIron(iron.matrix, iron.offset_mgauss, iron.motor_mgauss, IDENTITY, np.nan_to_num(load))
    return [Setting(effect, effect.default) for effect in known.effects()]


def effects_in(belief: PosteriorComponent, values: FloatArray) -> list[Setting]:
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
        iron = cured.cures.changed(values[MATRIX], values[OFFSET], values[MOTOR])
        effects = effects_in(belief, values)
        affine = [setting for setting in effects if setting.effect.affine]
        a, b = affine_map([*iron_settings(iron, np.zeros(4)), *affine])
        found = (s.theta for s in effects if s.effect.id == "motor_current")
        motor = sum(found, iron.motor_mgauss * by_current)
        return np.concatenate([b, (0.5 * (a + a.T))[_GAINS], motor])

    jacobian, here = np.zeros((len(IRON_NAMES), belief.mean.size)), whole(belief.mean)
    for place in np.flatnonzero(np.diag(belief.covariance)).tolist():
        step = _STEP * np.eye(belief.mean.size)[place]
        jacobian[:, place] = (whole(belief.mean + step) - here) / _STEP
    covariance = jacobian @ belief.covariance @ jacobian.T
    if not covariance[9:, 9:].any():
        covariance[9:, 9:] = usual.motors.untold_mgauss**2 * np.eye(3)
    motor = cured.cures.motor_mgauss * by_current
    if not motor.any():
        return here, covariance
    # The motors' field of a calibration is a measurement: a diagnosis leaves open what its recording cannot
    # exclude, far more than calibrations are wrong by.
    off = usual.motors.calibrated**2 * float(motor @ motor) * np.eye(3)
    gain = covariance[:, 9:] @ np.linalg.inv(covariance[9:, 9:] + off)
    return here + gain @ (motor - here[9:]), covariance - gain @ covariance[9:, :]


@dataclass(frozen=True, slots=True, eq=False)
class Individual:
    """Hold one vehicle, and the chances that it meets; K is `MOST_POSITIONS`.

    Attributes:
        field_ned_mgauss: the field where it is calibrated and used, (3,).
        iron: its own. settings: its effects.
        heading_rad: where it begins; turned_off_rad: how far each position is from where it should be, (K,).
        stance: which stance each position is, (K,); used: which of the recording's readings it is used in.
        chances: unit normals by source: of noise and quantisation at each position, (K, 3); of roll and pitch
            there, and at last of the accelerometer's own error, (K + 1, 2); of the steps of the gyro, its
            scale and its bias, (K + 2,).
    """

    field_ned_mgauss: FloatArray
    iron: Iron
    settings: tuple[Setting, ...]
    heading_rad: float
    turned_off_rad: FloatArray
    stance: NDArray[np.int64]
    used: int
    chances: Mapping[str, FloatArray]

    def without(self, names: Collection[str], kind: Kind) -> Individual:
        """Return it without some of its effects and of the sources of error."""
        spared = replace(self.iron, motor_mgauss=kind.iron.motor_mgauss)
        return replace(
            self,
            field_ned_mgauss=kind.field_ned_mgauss if FIELD in names else self.field_ned_mgauss,
            iron=spared if MOTORS in names else self.iron,
            settings=tuple(s for s in self.settings if s.effect.id not in names),
            chances={name: values * (name not in names) for name, values in self.chances.items()},
        )

    def chain(self, load: FloatArray) -> Distortion:
        """Return what its sensors make of the field; `load` (N,) is what the motors' field goes with."""
        return Distortion([*iron_settings(self.iron, load), *self.settings])


class Draws:
    """Draw vehicles of a kind; the same seed and number give the same vehicle."""

    def __init__(self, kind: Kind, seed: int) -> None:
        self._kind = kind
        self._seed = seed
        self._roots = [_root(belief.covariance) for belief in kind.beliefs]
        self._weights = np.array([belief.weight for belief in kind.beliefs])
        self._crossed = [_crossed(kind, belief) for belief in kind.beliefs]
        self._loaded = [_loaded(kind, belief) for belief in kind.beliefs]

    def __getitem__(self, number: int) -> Individual:
        """Return one vehicle."""
        rng, kind, k = np.random.default_rng([self._seed, number]), self._kind, MOST_POSITIONS
        which = int(rng.choice(self._weights.size, p=self._weights / self._weights.sum()))
        belief = kind.beliefs[which]
        values = belief.mean + self._roots[which] @ rng.standard_normal(belief.mean.size)
        if rng.random() >= self._loaded[which]:
            # What is known of all the rest once the motors are known to make no field.
            shared = belief.covariance[:, MOTOR] @ np.linalg.inv(belief.covariance[MOTOR, MOTOR])
            values = values - shared @ values[MOTOR]
        iron = kind.iron.changed(values[MATRIX], values[OFFSET], values[MOTOR])
        # A turn of the compass in the vehicle shows in no turn of both: it is the mounting's, see (M1).
        matrix = 0.5 * (iron.matrix + iron.matrix.T)
        for places, probability in zip(_CROSS, self._crossed[which], strict=True):
            if rng.random() >= probability:
                for i, j in places:
                    matrix[i, j] = matrix[j, i] = 0.0
        acting = [s for s in effects_in(belief, values) if s.effect.kind in _ACTING]
        return Individual(
            field_ned_mgauss=kind.field_ned_mgauss + values[:3],
            iron=replace(iron, matrix=matrix),
            settings=(*acting, *self._faults(rng)),
            heading_rad=float(rng.uniform(-math.pi, math.pi)),
            turned_off_rad=usual.stance.turn_rad * rng.standard_normal(k),
            stance=rng.integers(len(kind.stances), size=k),
            used=int(rng.integers(kind.used.time_s.size)),
            chances=_chances(rng, k),
        )

    def _faults(self, rng: np.random.Generator) -> list[Setting]:
        out = []
        for fault in self._kind.faults:
            effect = get(fault.effect)
            theta = effect.neutral()
            for i, name in enumerate(effect.names):
                low, high = fault.ci95.get(name, (theta[i], theta[i]))
                spread = (high - low) / (2.0 * 1.96) * float(rng.standard_normal())
                theta[i] = fault.parameters.get(name, theta[i]) + spread
            out.append(Setting(effect, np.clip(theta, effect.lower, effect.upper)))
        return out


def _chances(rng: np.random.Generator, count: int) -> dict[str, FloatArray]:
    noise, quantisation, tilt = (rng.standard_normal((count, width)) for width in (3, 3, 2))
    gyro = rng.standard_normal(count + 2)
    tilt = np.vstack([tilt, rng.standard_normal((1, 2))])
    return {NOISE: noise, QUANTISATION: quantisation, TILT: tilt, GYRO: gyro}


def _crossed(kind: Kind, belief: PosteriorComponent) -> list[float]:
    """Return how probable horizontal and vertical cross terms are, by the prior that the fit has too.

    Before anything is known a quarter of the compasses have some, of a certain size; what the recording
    leaves unknown of them is no reason to believe in those that it does not show.
    """
    matrix = kind.iron.matrix @ (np.eye(3) + belief.mean[MATRIX].reshape(3, 3))
    sigma = np.sqrt(np.diag(belief.covariance)[MATRIX]).reshape(3, 3)
    out = []
    for places in _CROSS:
        log_odds = math.log(CROSS_TERMS_BEFORE / (1.0 - CROSS_TERMS_BEFORE))
        for i, j in places:
            known = max(0.5 * math.hypot(sigma[i, j], sigma[j, i]), 1e-6)
            value, wide = 0.5 * (matrix[i, j] + matrix[j, i]), math.hypot(known, DEFAULT_PRIOR.cross_sigma)
            log_odds += 0.5 * value**2 * (1.0 / known**2 - 1.0 / wide**2) + math.log(known / wide)
        out.append(1.0 / (1.0 + math.exp(min(-log_odds, 700.0))))
    return out


def _loaded(kind: Kind, belief: PosteriorComponent) -> float:
    """Return how probable a field of the motors is that is neither found nor known to the calibration.

    What a recording leaves open of it is more than vehicles have: a doubt of every one, it would be told as
    the error of all.
    """
    covariance, mean = belief.covariance[MOTOR, MOTOR], belief.mean[MOTOR]
    if (
        "motor_current" in belief.effects
        or kind.iron.motor_mgauss.any()
        or np.linalg.matrix_rank(covariance) < 3
    ):
        return 1.0
    log_odds = math.log(usual.motors.before / (1.0 - usual.motors.before))
    log_odds += 0.5 * float(mean @ np.linalg.solve(covariance, mean))
    return 1.0 / (1.0 + math.exp(-log_odds))


def _root(covariance: FloatArray) -> FloatArray:
    """Return a square root of a covariance, which may be singular."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, 0.0))
