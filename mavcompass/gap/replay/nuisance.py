"""What a replay does not know exactly and must solve for besides any effect: never named as a cause.

Nuisances have a forward model like effects, and a prior: the field's model error, the reference's yaw,
the age of telemetry. A gap that fits inside these priors is no gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.attitude import UNKNOWN_YAW_RAD, exponentials
from mavcompass.simulation.effects.causes.timing import LONGEST_LAG_S, late_field
from mavcompass.simulation.effects.effect import Effect, Memory, Parameter, Signals, Stage

_Rng = np.random.Generator | None
_TURNS = 6
# How old a reading usually is when an autopilot reports it, and how much that differs.
USUAL_AGE_S, AGE_SIGMA_S = 0.06, 0.05
REFERENCE_YAW, TELEMETRY_AGE = "reference yaw", "telemetry age"


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """Hold a nuisance effect, its prior mean (k,) and the inverse of its prior covariance (k, k)."""

    effect: Effect
    mean: FloatArray
    precision: FloatArray

    @property
    def known(self) -> int:
        """Count the leading parameters that something is known of: how the attitude wanders is not."""
        return 1 if self.effect.id == REFERENCE_YAW else self.mean.size

    @classmethod
    def of(cls, effect: Effect, mean: FloatArray, sigma: FloatArray) -> Nuisance:
        """Build one with independent priors."""
        return cls(effect, mean, np.diag(1.0 / np.square(sigma)))


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Hold nuisances with the inverse of their joint prior covariance (K, K), K parameters in their order."""

    nuisances: tuple[Nuisance, ...]
    precision: FloatArray

    @classmethod
    def of(cls, nuisances: Sequence[Nuisance]) -> Prior:
        """Build the prior of nuisances that know nothing of each other."""
        return cls(tuple(nuisances), block_diagonal([n.precision for n in nuisances]))

    @property
    def mean(self) -> FloatArray:
        """Return the prior means of all parameters, (K,)."""
        return np.concatenate([n.mean for n in self.nuisances]) if self.nuisances else np.zeros(0)

    def moved(self, mean: FloatArray) -> Prior:
        """Return a prior with other means, (K,)."""
        starts = np.cumsum([0, *(n.mean.size for n in self.nuisances)])
        parts = (mean[a : a + n.mean.size] for a, n in zip(starts, self.nuisances, strict=False))
        return replace(
            self, nuisances=tuple(replace(n, mean=m) for n, m in zip(self.nuisances, parts, strict=True))
        )


def block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    """Put square blocks along a diagonal."""
    total = sum(len(b) for b in blocks)
    out = np.zeros((total, total))
    at = 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out


def _world_field(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
    return signals.in_field(signals.stimulus.field_ned_mgauss + theta)


WORLD_FIELD = Effect(
    id="world field",
    title="what the field's model does not know",
    stage=Stage.WORLD,
    parameters=tuple(Parameter(n, "mG", -2000.0, 2000.0, 0.0, 1.0) for n in ("north", "east", "down")),
    forward=_world_field,
    slopes=lambda signals, theta: signals.stimulus.rotation.transpose(0, 2, 1),
)


def turned(signals: Signals, vectors_rad: FloatArray, yaw_rad: float = 0.0) -> Signals:
    """Turn the believed attitude by rotation vectors in world axes (N, 3), and then about the vertical."""
    s = signals.stimulus
    rotation = exponentials(vectors_rad) @ s.rotation
    if yaw_rad != 0.0:
        rotation = euler_to_matrix(0.0, 0.0, yaw_rad) @ rotation
    change = rotate_back(rotation, s.field_ned_mgauss) - rotate_back(s.rotation, s.field_ned_mgauss)
    moved = Signals(replace(s, rotation=rotation), signals.reading)
    return moved.with_mag(signals.reading.mag_mgauss + change)


def reference_attitude_error(curves_rad: FloatArray, with_yaw: FloatArray | None = None) -> Effect:
    """Build what a reference does not know: a constant of the yaw, and curves (N, 3, k) over time.

    With each radian of the constant other turns go, (N, 3) or (1, 3), if any.
    """
    beside = np.zeros((1, 3)) if with_yaw is None else with_yaw

    flat = curves_rad.reshape(3 * len(curves_rad), curves_rad.shape[2])

    def forward(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
        vectors = (flat @ theta[1:]).reshape(-1, 3) + theta[0] * beside
        return turned(signals, vectors, float(theta[0]))

    amplitudes = (Parameter(f"curve {i + 1}", "1", -30.0, 30.0, 0.0, 1.0) for i in range(curves_rad.shape[2]))
    return Effect(
        id=REFERENCE_YAW,
        title="what the attitude reference does not know",
        stage=Stage.ATTITUDE,
        parameters=(Parameter("constant", "rad", -10.0, 10.0, 0.0, 0.01), *amplitudes),
        forward=forward,
    )


def yaw_starts(nuisances: Sequence[Nuisance]) -> list[tuple[FloatArray, ...]]:
    """List where to start a fit that may turn the attitude: from the prior; all around if that is wide."""
    means = tuple(n.mean for n in nuisances)
    for place, nuisance in enumerate(nuisances):
        if nuisance.effect.id == REFERENCE_YAW and nuisance.precision[0, 0] < 1.0 / UNKNOWN_YAW_RAD**2:
            starts = []
            for turn in np.arange(_TURNS) * 2.0 * np.pi / _TURNS:
                mean = nuisance.mean.copy()
                mean[0] = (mean[0] + turn + np.pi) % (2.0 * np.pi) - np.pi
                starts.append((*means[:place], mean, *means[place + 1 :]))
            return starts
    return [means]


def _telemetry_age(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
    return signals.with_mag(late_field(signals, signals.stimulus.time_s - theta[0]))


AGE = Effect(
    id=TELEMETRY_AGE,
    title="how old a reading is when the autopilot reports it, beyond what its time allows for",
    stage=Stage.TIMING,
    parameters=(Parameter("age", "s", -LONGEST_LAG_S, LONGEST_LAG_S, 0.08, 0.005),),
    forward=_telemetry_age,
)
