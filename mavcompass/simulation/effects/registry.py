"""Find the effects of `causes/`, by id; read settings as people write them."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from types import MappingProxyType

from mavcompass.errors import UsageError
from mavcompass.simulation.effects.effect import Effect, Setting
from mavcompass.simulation.effects.live import Distortion


@cache
def catalogue() -> MappingProxyType[str, Effect]:
    """Return every effect by id, in the order of stages; each file of `causes/` names its own."""
    folder = import_module("mavcompass.simulation.effects.causes")
    found: list[Effect] = []
    for module in pkgutil.iter_modules(folder.__path__, folder.__name__ + "."):
        found.extend(import_module(module.name).EFFECTS)
    ordered = sorted(found, key=lambda effect: (effect.stage, effect.id))
    by_id = {effect.id: effect for effect in ordered}
    if len(by_id) != len(found):
        raise ValueError("two effects of the catalogue have the same id")
    return MappingProxyType(by_id)


def get(effect_id: str) -> Effect:
    """Return one effect. Raises UsageError for a name that is not in the catalogue."""
    effect = catalogue().get(effect_id)
    if effect is None:
        import difflib

        near = difflib.get_close_matches(effect_id, catalogue(), n=1)
        hint = f"Did you mean {near[0]}? " if near else ""
        raise UsageError(
            f"There is no effect called {effect_id!r}.", f"{hint}`mavcompass gap catalogue` lists them."
        )
    return effect


def parse(text: str) -> Setting:
    """Read `NAME` or `NAME:param=value,param=value`. Raises UsageError saying what is wrong."""
    name, _, rest = text.strip().partition(":")
    values: dict[str, float] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, number = item.partition("=")
        try:
            if not equals:
                raise ValueError
            values[key.strip()] = float(number)
        except ValueError:
            raise UsageError(
                f"{item!r} in the effect {text!r} is not a parameter with a number.",
                "Write it as NAME:param=value,param=value, for example hard_iron:x=100,y=-50.",
            ) from None
    return Setting.of(get(name), values)


def default(effect_id: str) -> Setting:
    """Return an effect with its typical parameters."""
    return Setting.of(get(effect_id))


def distortion(texts: list[str] | tuple[str, ...]) -> Distortion:
    """Compose the effects that a person named into one distortion of a live vehicle."""
    return Distortion([parse(text) for text in texts])
