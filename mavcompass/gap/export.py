"""Put the found effects into a simulator: ArduPilot's by its parameters, ours by a preset."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.result import Cause
from mavcompass.simulation.effects import Setting, get, spell
from mavcompass.simulation.effects.effect import Chain, Signals
from mavcompass.simulation.effects.registry import PRESET_SCHEMA
from mavcompass.simulation.signals import Reading, Stimulus

Target = Literal["ardupilot-sitl", "mavcompass"]
_ROTATION_WORTH_SAYING_RAD = math.radians(0.1)
_AXES = "XYZ"


@dataclass(frozen=True, slots=True)
class Exported:
    """Hold a simulator's parameters, and in sentences what it cannot do."""

    parameters: dict[str, float]
    lacking: tuple[str, ...]


def settings_of(causes: Iterable[Cause]) -> list[Setting]:
    """Turn named causes into settings of their effects; parameters that were not fitted are neutral."""
    out = []
    for cause in causes:
        effect = get(cause.effect)
        theta = effect.neutral()
        for i, parameter in enumerate(effect.parameters):
            theta[i] = cause.parameters.get(parameter.name, theta[i])
        out.append(Setting(effect, np.clip(theta, effect.lower, effect.upper)))
    return out


def affine_map(settings: Sequence[Setting]) -> tuple[FloatArray, FloatArray]:
    """Compose affine effects to raw = A field + b: A (3, 3), b (3,), by passing a basis through them."""
    field: FloatArray = np.zeros((4, 3))
    field[1:] = 100.0 * np.eye(3)
    n = len(field)
    rotation: FloatArray = np.broadcast_to(np.eye(3), (n, 3, 3)).astype(np.float64)
    zero, none = np.zeros((n, 3)), np.zeros(n)
    stimulus = Stimulus(
        np.arange(n, dtype=np.float64), rotation, field, zero, zero, zero, zero, none, none, none,
        np.zeros((n, 0)),
    )  # fmt: skip
    out = Chain(list(settings)).run(Signals(stimulus, Reading(field, zero, zero)), None)
    raw = out.reading.mag_mgauss
    return (raw[1:] - raw[0]).T / 100.0, raw[0]


def ardupilot_sitl(settings: Sequence[Setting]) -> Exported:
    """Spell effects as parameters of ArduPilot's simulator, compass 1.

    The simulator makes raw = E^-1 field - OFS with E symmetric (SIM_MAG1_DIA, SIM_MAG1_ODI). With
    raw = A field + b and the polar form A = P R: E = P^-1, OFS = -b; the rotation R it does not have.
    """
    parameters: dict[str, float] = {}
    lacking: list[str] = []
    affine = [s for s in settings if s.effect.affine]
    if affine:
        matrix, offset = affine_map(affine)
        u, sizes, vt = np.linalg.svd(matrix)
        rotation = u @ vt
        cure = u @ np.diag(1.0 / sizes) @ u.T
        angle = math.acos(float(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
        if angle > _ROTATION_WORTH_SAYING_RAD:
            lacking.append(
                f"A rotation of the compass by {math.degrees(angle):.2f} degrees: the simulator turns its"
                " compass only in steps (SIM_MAG1_ORIENT)."
            )
        for i, axis in enumerate(_AXES):
            parameters[f"SIM_MAG1_OFS_{axis}"] = float(-offset[i])
        for i, axis in enumerate(_AXES):
            # All three together: the firmware ignores a matrix of which only some are set.
            parameters[f"SIM_MAG1_DIA_{axis}"] = float(cure[i, i])
        for axis, (i, j) in zip(_AXES, ((0, 1), (0, 2), (1, 2)), strict=True):
            parameters[f"SIM_MAG1_ODI_{axis}"] = float(cure[i, j])
    for setting in settings:
        if setting.effect.affine:
            continue
        if setting.effect.sitl is None:
            lacking.append(
                f"{setting.effect.id}: {setting.effect.title}. ArduPilot's simulator has no such thing."
            )
        else:
            parameters |= setting.effect.sitl(setting.values)
    return Exported(parameters, tuple(lacking))


def parameter_file(exported: Exported, source: str) -> str:
    """Write a parameter file that ArduPilot's simulator and ground stations load."""
    lines = [f"# What was found in {source or 'a recording'}, for ArduPilot's simulator"]
    lines += [f"# not in the simulator: {sentence}" for sentence in exported.lacking]
    lines += [f"{name},{value:.6g}" for name, value in exported.parameters.items()]
    return "\n".join(lines) + "\n"


def preset(settings: Sequence[Setting], source: str) -> str:
    """Write a preset of our own simulator: `mavcompass simulate --effect @FILE`."""
    document = {"schema": PRESET_SCHEMA, "source": source, "effects": [spell(s) for s in settings]}
    return json.dumps(document, indent=2) + "\n"
