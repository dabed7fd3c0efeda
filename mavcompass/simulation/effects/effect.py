"""Effect: a physical cause with its parameters and the one forward model that everybody uses.

A forward model takes `Signals` (what reaches the sensors, and what they say so far) and returns them
changed. Effects that act on the world or the attitude change the stimulus and what the sensors say of
it; effects of the sensor change what it says. They are composed in the order of their stages.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mavcompass.errors import UsageError
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.signals import Reading, Stimulus
from mavcompass.simulation.physics.signals import Signals as Signals

Memory = dict[str, Any]
Kind = Literal["mean", "discrete", "random", "integrity"]
Group = Literal["mag", "acc", "gyro"]
Detector = Literal[
    "repeats", "steps", "alternation", "line", "scatter", "jitter", "drift",
    "accelerometer offset", "gyro offset", "gyro gain",
]  # fmt: skip
# Moments of change that lie outside every recording.
NEVER_S = 1.0e7
# 1 where an error of the sensor acts on the vehicle's iron too, 0 where it acts on the field alone.
ON_IRON = "on_iron"
# Parameters that are moments of change, whatever effect they belong to.
MOMENTS = frozenset({"on_s", "off_s"})
# And other parameters that mean the same in every effect: the load from which on something is switched, the
# frequency of a line, what no reading passes, by how much readings are late, the time constant that smooths.
THRESHOLD, FREQUENCY, LIMIT, LAG, SMOOTHING = (
    "threshold", "frequency_hz", "limit_mgauss", "lag_s", "time_constant_s"
)  # fmt: skip
# What a recording has that tells where it was made: what effects need that belong to a place.
PLACED = frozenset({"position", "height"})
GROUPS: tuple[Group, ...] = ("mag", "acc", "gyro")


class Stage(IntEnum):
    """Order the effects from the world to the number that is logged.

    `IRON` around the sensor bends the field before the sensor's own `MATRIX` does.
    """

    ATTITUDE = 0
    WORLD = 1
    HULL = 2
    IRON = 3
    MATRIX = 4
    FIELD = 5
    MOUNTING = 6
    TIMING = 7
    SENSOR = 8
    IMU = 9


# Stages whose effects change each reading of the compass by itself, without its neighbours; those of `FIELD`
# add to it what does not depend on it.
EACH_BY_ITSELF = frozenset({Stage.IRON, Stage.MATRIX, Stage.FIELD, Stage.MOUNTING})


@dataclass(frozen=True, slots=True)
class Parameter:
    """Describe one parameter: unit, physical range, a typical simulated value, and its natural size.

    One that is `optional` costs nothing in a fit while it stays at an end of its range.
    """

    name: str
    unit: str
    low: float
    high: float
    default: float
    scale: float
    integer: bool = False
    optional: bool = False


# None asks for the mean of what is random.
Rng = np.random.Generator | None
Forward = Callable[[Signals, FloatArray, Memory, Rng], Signals]
Change = Callable[[FloatArray, FloatArray], FloatArray]


def on_mag(change: Change) -> Forward:
    """Make the model that changes each reading of the compass by itself, of the readings (N, 3) and theta."""
    return lambda signals, theta, memory, rng: signals.with_mag(change(signals.reading.mag_mgauss, theta))


def on_acc(change: Change) -> Forward:
    """Make the same of the accelerometer."""
    return lambda signals, theta, memory, rng: signals.with_acc(change(signals.reading.acc_mps2, theta))


def on_gyro(change: Change) -> Forward:
    """Make the same of the gyro."""
    return lambda signals, theta, memory, rng: signals.with_gyro(change(signals.reading.gyro_radps, theta))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Hold what a model leaves unexplained: measured minus predicted, and the signals it predicts with.

    `rows` tells which samples may be looked at; `sigma` is the noise of each magnetometer axis;
    `yaw_unknown` that a turn of the whole attitude about the vertical is still to be found.
    """

    signals: Signals
    residual: Reading
    rows: NDArray[np.bool_]
    sigma_mgauss: FloatArray
    yaw_unknown: bool = False

    @property
    def time_s(self) -> FloatArray:
        """Return the times of the samples, (N,)."""
        return self.signals.stimulus.time_s


Starts = Callable[[Misfit], list[FloatArray]]
Freedom = Callable[[Signals], NDArray[np.bool_]]
Limits = Callable[[Signals], tuple[FloatArray, FloatArray]]
Export = Callable[[Mapping[str, float]], dict[str, float]]
Script = Callable[[Mapping[str, float]], str | None]


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """Describe one physical effect.

    Attributes:
        id: its name in commands and results; title: a few words.
        stage: its place in the order of composition; one with a parameter `on_iron` is before the iron, or
            behind it, as that says.
        parameters: what can be set and is fitted.
        forward: the model; `memory` is carried between the blocks of a live run, empty at the start.
        groups: the sensors that see it.
        enough: sensors of which one, beside the compass, can tell it, where others see it too.
        kind: "mean" shifts the readings; "discrete" has integer parameters; "random" changes their
            scatter; "integrity" leaves an exact trace (repeats, steps).
        needs: what a recording must contain: current, throttle, temperature, position, height, motors, tilt,
            turning, limit (readings that pile up), reference (an attitude that the vehicle's own sensors did
            not make).
        aliases: effects that can look the same; separated_by: the motion that tells them apart.
        source: where the model or its size comes from.
        starts: first guesses for a fit, where zero is no good one.
        free: which parameters a recording can tell at all (default: all).
        affine: True for a linear map plus offset of the field in body axes.
        sitl: the parameters of ArduPilot's simulator for a fitted setting.
        lua: what a script of ArduPilot's adds to the field b for one, in the functions that `gap/export`
            gives to scripts; None where it cannot.
        limits: how far a recording lets the parameters go (lower, upper), where that is less than the
            physical range.
        detector: what shows it by itself, beside or instead of a search over sets.
        daily: what differs from one good flight of a vehicle to the next, in the parameters' unit.
        about_vertical: True for a turn of the world's field about the vertical, which a yaw hides.
    """

    id: str
    title: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    forward: Forward
    groups: tuple[Group, ...] = ("mag",)
    kind: Kind = "mean"
    needs: frozenset[str] = frozenset()
    aliases: tuple[str, ...] = ()
    separated_by: str = ""
    source: str = ""
    starts: Starts | None = None
    free: Freedom | None = None
    affine: bool = False
    sitl: Export | None = None
    lua: Script | None = None
    limits: Limits | None = None
    enough: tuple[Group, ...] = ()
    detector: Detector | None = None
    daily: float = 0.0
    about_vertical: bool = False

    @property
    def switched(self) -> bool:
        """Tell whether a load switches it."""
        return THRESHOLD in self.names

    @property
    def moves(self) -> bool:
        """Tell whether it comes or goes at a moment, or as something is switched: not only perhaps."""
        return self.switched or any(p.name in MOMENTS and not p.optional for p in self.parameters)

    def lacking(self, present: Collection[str]) -> list[str]:
        """List the needs of which a recording with these present has none."""
        return sorted(need for need in self.needs if not set(need.split("|")) & set(present))

    @property
    def of_vehicle(self) -> bool:
        """Tell whether it is the vehicle's own, and neither the world's nor a moment's."""
        return self.stage > Stage.WORLD and not MOMENTS & set(self.names)

    @property
    def delays(self) -> NDArray[np.bool_]:
        """Tell which parameters are times by which readings are late, (k,)."""
        own = self.kind == "mean"
        return np.array([own and p.unit == "s" and p.low >= 0.0 for p in self.parameters])

    def value(self, theta: FloatArray, name: str) -> float | None:
        """Return a parameter by its name; None where the effect has none of that name."""
        return float(theta[self.names.index(name)]) if name in self.names else None

    def stage_at(self, theta: FloatArray) -> Stage:
        """Return the place in the order of composition that the effect has with these parameters."""
        for parameter, value in zip(self.parameters, theta, strict=True):
            if parameter.name == ON_IRON:
                return Stage.MOUNTING if value > 0.5 else Stage.MATRIX
        return self.stage

    @property
    def lower(self) -> FloatArray:
        """Return the lower ends of the physical ranges, (k,)."""
        return np.array([p.low for p in self.parameters])

    @property
    def upper(self) -> FloatArray:
        """Return the upper ends of the physical ranges, (k,)."""
        return np.array([p.high for p in self.parameters])

    @property
    def scale(self) -> FloatArray:
        """Return the natural sizes of the parameters, (k,)."""
        return np.array([p.scale for p in self.parameters])

    @property
    def default(self) -> FloatArray:
        """Return the typical values a simulation uses, (k,)."""
        return np.array([p.default for p in self.parameters])

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def neutral(self) -> FloatArray:
        """Return parameters near which the effect does nothing: amplitudes are zero, or as near as may be."""
        zero = np.clip(np.zeros(len(self.parameters)), self.lower, self.upper)
        always = np.array([p.optional for p in self.parameters], dtype=np.bool_)
        return np.where(always, self.default, zero)


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """Be an effect with values for its parameters."""

    effect: Effect
    theta: FloatArray

    @classmethod
    def of(cls, effect: Effect, values: Mapping[str, float] = MappingProxyType({})) -> Setting:
        """Set some parameters by name.

        Where none is named all take their typical values; otherwise the unnamed amplitudes are zero.
        Raises UsageError for an unknown name or a value outside its physical range.
        """
        if unknown := set(values) - set(effect.names):
            raise UsageError(
                f"The effect {effect.id} has no parameter {', '.join(sorted(unknown))}.",
                f"Its parameters are {', '.join(effect.names)}.",
            )
        theta = np.array([_value(p, values) for p in effect.parameters])
        for parameter, value in zip(effect.parameters, theta, strict=True):
            if not parameter.low <= value <= parameter.high:
                raise UsageError(
                    f"{effect.id}: {parameter.name} = {value:g} {parameter.unit} is not physical.",
                    f"It lies between {parameter.low:g} and {parameter.high:g}.",
                )
        return cls(effect, theta)

    @property
    def values(self) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.effect.names, self.theta.tolist(), strict=True))


def _value(parameter: Parameter, values: Mapping[str, float]) -> float:
    if parameter.name in values:
        return float(values[parameter.name])
    # A range that holds zero on both sides is an amplitude: not named, it is absent.
    amplitude = parameter.low < 0.0 < parameter.high and parameter.unit != "s"
    return 0.0 if values and amplitude else parameter.default


class Distortion:
    """Be several settings, composed in the order of their stages.

    Blocks follow each other in time and have one sample or more; what an effect must remember (a delay's
    buffer, a drift's value) is carried from block to block, so the split into blocks does not matter.
    """

    def __init__(self, settings: Sequence[Setting]) -> None:
        self.settings = tuple(sorted(settings, key=lambda s: s.effect.stage_at(s.theta)))
        self._memories: list[Memory] = [{} for _ in self.settings]

    @property
    def groups(self) -> frozenset[Group]:
        """Return the sensors that the effects change."""
        return frozenset(group for setting in self.settings for group in setting.effect.groups)

    def run(self, signals: Signals, rng: Rng) -> Signals:
        """Pass a block of samples through all effects; without `rng` as the mean of what is random."""
        for setting, memory in zip(self.settings, self._memories, strict=True):
            signals = setting.effect.forward(signals, setting.theta, memory, rng)
        return signals

    def apply(self, stimulus: Stimulus, reading: Reading, rng: np.random.Generator) -> Reading:
        """Return the reading of a live vehicle's sensors as the effects change it."""
        return self.run(Signals(stimulus, reading), rng).reading


def on_iron(usually: bool) -> Parameter:
    """Describe the parameter that tells whether an error of the sensor acts on the vehicle's iron too."""
    return Parameter(ON_IRON, "1", 0.0, 1.0, float(usually), 0.0, integer=True, optional=True)


def axes(
    low: float,
    high: float,
    defaults: Sequence[float],
    scale: float,
    unit: str,
    names: Sequence[str] = ("x", "y", "z"),
) -> tuple[Parameter, ...]:
    """Describe the components of a vector parameter, which have all but their defaults in common."""
    return tuple(Parameter(n, unit, low, high, d, scale) for n, d in zip(names, defaults, strict=True))
