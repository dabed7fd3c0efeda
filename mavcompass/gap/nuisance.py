"""What a replay does not know exactly and must solve for besides any effect: never named as a cause.

Nuisances have a forward model like effects, and a prior: the field's model error, the reference's yaw,
the age of telemetry. A gap that fits inside these priors is no gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.frames import FloatArray, rotate_back
from mavcompass.simulation.effects.causes.timing import LONGEST_LAG_S
from mavcompass.simulation.effects.effect import Effect, Memory, Parameter, Signals, Stage
from mavcompass.simulation.effects.sampling import at_times

_Rng = np.random.Generator | None
_UNKNOWN_YAW_RAD = 0.3
_TURNS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """Hold a nuisance effect, its prior mean (k,) and the inverse of its prior covariance (k, k)."""

    effect: Effect
    mean: FloatArray
    precision: FloatArray

    @classmethod
    def of(cls, effect: Effect, mean: FloatArray, sigma: FloatArray) -> Nuisance:
        """Build one with independent priors."""
        return cls(effect, mean, np.diag(1.0 / np.square(sigma)))


def _world_field(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
    return signals.in_field(signals.stimulus.field_ned_mgauss + theta)


def _reference_yaw(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
    s = signals.stimulus
    heading = np.arctan2(s.rotation[:, 1, 0], s.rotation[:, 0, 0])
    middle = 0.5 * (s.time_s[0] + s.time_s[-1])
    angle = theta[0] + theta[1] * (s.time_s - middle)
    angle = angle + theta[2] * np.sin(heading) + theta[3] * np.cos(heading)
    c, d = np.cos(angle), np.sin(angle)
    rotation = s.rotation.copy()
    rotation[:, 0] = c[:, None] * s.rotation[:, 0] - d[:, None] * s.rotation[:, 1]
    rotation[:, 1] = d[:, None] * s.rotation[:, 0] + c[:, None] * s.rotation[:, 1]
    change = rotate_back(rotation, s.field_ned_mgauss) - rotate_back(s.rotation, s.field_ned_mgauss)
    return Signals(replace(s, rotation=rotation), signals.reading).with_mag(
        signals.reading.mag_mgauss + change
    )


WORLD_FIELD = Effect(
    id="world field",
    title="what the field's model does not know",
    stage=Stage.WORLD,
    parameters=tuple(Parameter(n, "mG", -2000.0, 2000.0, 0.0, 1.0) for n in ("north", "east", "down")),
    forward=_world_field,
)
REFERENCE_YAW = Effect(
    id="reference yaw",
    title="what the attitude reference does not know of the yaw",
    stage=Stage.ATTITUDE,
    parameters=(
        Parameter("constant", "rad", -10.0, 10.0, 0.0, 0.01),
        Parameter("drift", "rad/s", -0.1, 0.1, 0.0, 1e-4),
        Parameter("sine", "rad", -1.0, 1.0, 0.0, 0.01),
        Parameter("cosine", "rad", -1.0, 1.0, 0.0, 0.01),
    ),
    forward=_reference_yaw,
)


def yaw_starts(nuisances: Sequence[Nuisance]) -> list[tuple[FloatArray, ...]]:
    """List where to start a fit that may turn the attitude: from the prior; all around if that is wide."""
    means = tuple(n.mean for n in nuisances)
    for place, nuisance in enumerate(nuisances):
        if nuisance.effect is REFERENCE_YAW and nuisance.precision[0, 0] < 1.0 / _UNKNOWN_YAW_RAD**2:
            starts = []
            for turn in np.arange(_TURNS) * 2.0 * np.pi / _TURNS:
                mean = nuisance.mean.copy()
                mean[0] = (mean[0] + turn + np.pi) % (2.0 * np.pi) - np.pi
                starts.append((*means[:place], mean, *means[place + 1 :]))
            return starts
    return [means]


def telemetry_age(hold_s: FloatArray) -> Effect:
    """Build the age of an autopilot's telemetry: a common delay behind `hold_s` (N,) of each row.

    The firmware reads its compass ten times a second, averaged, and repeats the value in faster streams.
    """

    def forward(signals: Signals, theta: FloatArray, memory: Memory, rng: _Rng) -> Signals:
        time = signals.stimulus.time_s
        return signals.with_mag(at_times(time, signals.reading.mag_mgauss, time - hold_s - theta[0]))

    return Effect(
        id="telemetry age",
        title="how old a reading is when the autopilot reports it",
        stage=Stage.TIMING,
        parameters=(Parameter("age", "s", 0.0, LONGEST_LAG_S, 0.08, 0.005),),
        forward=forward,
    )
