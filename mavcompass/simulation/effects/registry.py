"""Find the effects of `causes/`, by id; read settings as people write them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from types import MappingProxyType

from mavcompass.errors import UsageError
from mavcompass.files import read_text
from mavcompass.installation.doors import modules_in
from mavcompass.simulation.effects import causes
from mavcompass.simulation.effects.effect import Detector, Distortion, Effect, Setting

PRESET_SCHEMA = "mavcompass.simulation-preset/1"


@cache
def catalogue() -> MappingProxyType[str, Effect]:
    """Return every effect by id, in the order of stages; each file of `causes/` names its own."""
    found = [effect for module in modules_in(causes) for effect in module.EFFECTS]
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


@cache
def detected_by(detector: Detector) -> Effect:
    """Return the effect that a detector shows."""
    return next(effect for effect in catalogue().values() if effect.detector == detector)


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


def spell(setting: Setting) -> str:
    """Write a setting as `parse` reads it."""
    values = ",".join(f"{name}={value:.9g}" for name, value in setting.values.items())
    return f"{setting.effect.id}:{values}"


def read_preset(path: Path) -> list[Setting]:
    """Read a simulation preset, as `mavcompass gap export --to mavcompass` writes it.

    Raises UsageError for a file that is not one.
    """
    try:
        document = json.loads(read_text(path))
        texts = document["effects"]
        if document["schema"] != PRESET_SCHEMA or not all(isinstance(text, str) for text in texts):
            raise KeyError("schema")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise UsageError(
            f"{path} is not a simulation preset ({error}).",
            "Make one with `mavcompass gap export LOG --to mavcompass FILE`.",
        ) from error
    return [parse(text) for text in texts]


def distortion(texts: list[str] | tuple[str, ...]) -> Distortion:
    """Compose the effects that a person named into one distortion of a live vehicle.

    `@FILE` stands for all the effects of a preset.
    """
    settings: list[Setting] = []
    for text in texts:
        settings += read_preset(Path(text[1:])) if text.startswith("@") else [parse(text)]
    return Distortion(settings)
