"""A kind of effect: where it acts, what is drawn of it, how it grows to a wanted size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.gap.trial.vehicles.draw import unit
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, Stage, Values, readings, stream

Rng = np.random.Generator
Grow = Callable[[float], Values]
AXES = "xyz"
FLOOR_MGAUSS = 3.0
SMALLEST, LARGEST = 0.5, 12.0
_NEAR_ENOUGH = 0.03
_TRIES = 7


@dataclass(frozen=True, slots=True)
class Kind:
    """Describe a kind of effect.

    Attributes:
        id: its name; stage: where in the chain it acts.
        draw: draws all but the size and returns what makes the parameters from a size.
        act: changes the values (M, 3) of its stage.
        first, most: a size to try first, and the largest that nature offers.
        needs: "way" a path, "near" a small one on the ground, "loads" motors that work, "altitude", "wheels",
            "warming", "each_row" a compass whose readings are not averaged and repeated.
        sized: False for what has no size.
    """

    id: str
    stage: Stage
    draw: Callable[[Rng, Scene], Grow]
    act: Callable[[Array, Values, Scene, Rng], Array]
    first: float
    most: float
    needs: frozenset[str] = frozenset()
    sized: bool = True


def of(values: Values, names: tuple[str, ...] | str = AXES) -> Array:
    """Pick named values as an array."""
    return np.array([values[name] for name in names])


def grown(rng: Rng, names: tuple[str, ...] | str = AXES, **others: float) -> Grow:
    """Let named components grow along a drawn direction, beside values that stay."""
    along = unit(rng, len(names))
    return lambda size: {**dict(zip(names, (size * along).tolist(), strict=True)), **others}


def only(name: str) -> Callable[[Rng, Scene], Grow]:
    """Draw nothing: one named value is the size."""
    return lambda rng, scene: lambda size: {name: size}


def along(names: tuple[str, ...] | str = AXES) -> Callable[[Rng, Scene], Grow]:
    """Draw a direction for named components."""
    return lambda rng, scene: grown(rng, names)


def reference(rng: Rng, scene: Scene) -> float:
    """Draw the temperature at which nothing is added, near that of the start, degC."""
    return float(scene.loads.temperature_degc[0] + rng.normal(0.0, 2.0))


def above(p: Values, scene: Scene) -> Array:
    """Return the temperature above the reference, (N, 1), degC."""
    return scene.loads.temperature_degc[:, None] - p["reference_degc"]


def changed_rms(scene: Scene, effects: tuple[Effect, ...]) -> float:
    """Return how much effects change the raw readings without noise: rms per axis, milligauss."""
    plain = readings(scene, scene.plain_mgauss)
    return _rms(readings(scene, stream(scene, effects), effects) - plain)


def sized(kind: Kind, scene: Scene, target_mgauss: float, rng: np.random.Generator) -> Effect | None:
    """Draw an effect that changes the readings by a target (rms per axis); None where nature offers no such.

    What reaches a natural limit below the target is taken as long as it changes half a floor.
    """
    seed = int(rng.integers(2**62))
    grow = kind.draw(rng, scene)

    def of_size(size: float) -> Effect:
        return Effect(kind.id, kind.stage, kind.act, grow(size), seed)

    if not kind.sized:
        return of_size(1.0)
    plain = readings(scene, scene.plain_mgauss)
    size, power, before = kind.first, 1.0, (0.0, 0.0)
    for _ in range(_TRIES):
        effect = of_size(size)
        change = _rms(readings(scene, stream(scene, (effect,)), (effect,)) - plain)
        if change <= 0.0:
            return None
        if abs(change / target_mgauss - 1.0) < _NEAR_ENOUGH:
            return effect
        if size == kind.most and change < target_mgauss:
            return effect if change >= SMALLEST * FLOOR_MGAUSS else None
        here = (float(np.log(size)), float(np.log(change)))
        if before != (0.0, 0.0) and abs(here[0] - before[0]) > 1e-6:
            power = float(np.clip((here[1] - before[1]) / (here[0] - before[0]), 0.3, 3.0))
        before = here
        size = min(size * float((target_mgauss / change) ** (1.0 / power)), kind.most)
    inside = SMALLEST * FLOOR_MGAUSS <= change <= LARGEST * FLOOR_MGAUSS
    return effect if inside else None


def _rms(change: np.ndarray) -> float:
    return float(np.sqrt(np.mean(change**2)))
