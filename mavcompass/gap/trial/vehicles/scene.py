"""A vehicle in one motion, and the chain from the world's field to the compass's readings.

    world field -> body axes -> hull -> soft iron -> matrix, iron, current (the vehicle as it is)
      -> fields added at the sensor -> the sensor's own gains and axes -> electronics -> readings

What happens at the sensor acts on all that it measures, the vehicle's iron included.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
import scipy

from mavcompass.gap.trial.vehicles.draw import Compass, Vehicle
from mavcompass.gap.trial.vehicles.loads import Loads
from mavcompass.gap.trial.vehicles.motion import STEP_S, Motion
from mavcompass.gap.trial.vehicles.rotations import Array, to_body

Values = dict[str, float]
_READ_EVERY_S = 0.1
_AVERAGED = 10
_SLOW_NOISE_S = 3.0


class Stage(IntEnum):
    """Order the places of the chain where something can act."""

    WORLD = 0
    AMBIENT = 1
    OUTPUT = 2
    SENSOR = 3
    STREAM = 4
    READING = 5


@dataclass(frozen=True, eq=False)
class Scene:
    """Hold a vehicle in a motion at a site.

    Attributes:
        field_mgauss: the world's field there, (3,), NED.
        start_s: time since boot at the motion's time 0.
        row_s: times of the messages, (R,), from the motion's time 0.
        reading_s: times of the compass readings, (K,); held: the reading that each message carries, (R,).
    """

    vehicle: Vehicle
    motion: Motion
    loads: Loads
    field_mgauss: Array
    start_s: float
    row_s: Array
    reading_s: Array
    held: np.ndarray

    @cached_property
    def plain_mgauss(self) -> Array:
        """Return what the sensor converts without any effect, (N, 3)."""
        return stream(self)

    @property
    def compass(self) -> Compass:
        """Return the compass under test."""
        return self.vehicle.compass


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """Hold an effect with its values: `act(values (M, 3), parameters, scene, rng)` at its stage.

    The generator that `act` gets starts anew from `seed` each time: an effect is the same whenever asked.
    """

    id: str
    stage: Stage
    act: Callable[[Array, Values, Scene, np.random.Generator], Array]
    parameters: Values
    seed: int = field(default=0)


def scene_of(
    vehicle: Vehicle, motion: Motion, loads: Loads, field_mgauss: Array, rng: np.random.Generator
) -> Scene:
    """Put a vehicle into a motion: when its messages are sent and its compass is read."""
    count = int(motion.time_s[-1] * vehicle.rate_hz)
    rows = (np.arange(count) + 0.5) / vehicle.rate_hz + np.abs(rng.normal(0.0, 8e-4, count))
    rows = np.minimum(rows, motion.time_s[-1])
    readings, held = rows, np.arange(count)
    if vehicle.compass.averaged:
        readings = np.arange(rng.uniform(0.0, _READ_EVERY_S), motion.time_s[-1], _READ_EVERY_S)
        held = np.maximum(np.searchsorted(readings, rows, side="right") - 1, 0)
    start = float(np.exp(rng.uniform(np.log(50.0), np.log(900.0))))
    return Scene(vehicle, motion, loads, field_mgauss, start, rows, readings, held)


def ambient(scene: Scene, effects: Sequence[Effect] = ()) -> Array:
    """Return the world's field at the vehicle in body axes at 100 Hz, (N, 3), milligauss."""
    world = np.tile(scene.field_mgauss, (scene.motion.time_s.size, 1))
    return to_body(scene.motion.rotation, _acted(world, Stage.WORLD, scene, effects))


def stream(scene: Scene, effects: Sequence[Effect] = ()) -> Array:
    """Return what the sensor converts at 100 Hz, without noise, (N, 3), milligauss."""
    compass = scene.compass
    around = _acted(ambient(scene, effects), Stage.AMBIENT, scene, effects)
    raw = around @ compass.matrix.T + compass.iron_mgauss
    raw = raw + scene.loads.current_a[:, None] * compass.current_field
    for stage in (Stage.OUTPUT, Stage.SENSOR, Stage.STREAM):
        raw = _acted(raw, stage, scene, effects)
    return raw


def readings(
    scene: Scene, raw: Array, effects: Sequence[Effect] = (), noise: np.random.Generator | None = None
) -> Array:
    """Read what `stream` gave (N, 3) at `scene.reading_s`: (K, 3) milligauss, with noise from a generator."""
    latest = np.minimum((scene.reading_s / STEP_S).astype(np.int64), len(raw) - 1)
    if scene.compass.averaged:
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(raw, axis=0)])
        first = np.maximum(latest + 1 - _AVERAGED, 0)
        read = (total[latest + 1] - total[first]) / (latest + 1 - first)[:, None]
    else:
        read = raw[latest]
    if noise is not None:
        read = read + _noise(scene, noise)
    return _acted(read, Stage.READING, scene, effects)


def _noise(scene: Scene, rng: np.random.Generator) -> Array:
    shape = (scene.reading_s.size, 3)
    keep = np.exp(-np.median(np.diff(scene.reading_s)) / _SLOW_NOISE_S)
    slow = scipy.signal.lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(shape), axis=0)
    white = rng.standard_normal(shape) * scene.compass.noise_mgauss
    return np.asarray(white + scene.compass.slow_noise_mgauss * slow)


def _acted(values: Array, stage: Stage, scene: Scene, effects: Sequence[Effect]) -> Array:
    for effect in effects:
        if effect.stage == stage:
            values = effect.act(values, effect.parameters, scene, np.random.default_rng(effect.seed))
    return values
