"""Put the found effects into a simulator: ArduPilot's by its parameters, ours by a preset."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.result import Cause, Diagnosis
from mavcompass.simulation.effects import Setting, get, spell
from mavcompass.simulation.effects.effect import Chain, Signals
from mavcompass.simulation.effects.registry import PRESET_SCHEMA
from mavcompass.simulation.physics.signals import Reading, Stimulus

_ROTATION_LEFT_OUT_RAD = math.radians(0.05)
Target = Literal["ardupilot-sitl", "mavcompass"]
_ROTATION_WORTH_SAYING_RAD = math.radians(0.1)
_AXES = "XYZ"
_LEAST_MOTOR = 0.02


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


def vehicle_settings(diagnosis: Diagnosis) -> list[Setting]:
    """Return what makes a simulator of the whole vehicle: the iron that its calibration cures, and the
    causes.

    Of raw = A field + b the matrix is split into a turn and a symmetric part, A = R S.
    """
    causes = settings_of(diagnosis.causes)
    iron = diagnosis.in_force
    if iron is None:
        return causes
    u, sizes, vt = np.linalg.svd(iron.tuned_matrix)
    turn, stretch = u @ vt, vt.T @ np.diag(sizes) @ vt
    vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    offset = turn.T @ iron.tuned_hard_iron_mgauss
    found: dict[str, dict[str, float]] = {}
    if np.abs(offset).max() > 0.0:
        found["hard_iron"] = dict(zip("xyz", offset.tolist(), strict=True))
    soft = stretch - np.eye(3)
    if np.abs(soft).max() > 1e-6:
        places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
        found["soft_iron"] = {name: float(soft[i, j]) for name, (i, j) in places.items()}
    if float(np.linalg.norm(vector)) > _ROTATION_LEFT_OUT_RAD:
        found["misalignment"] = dict(zip("xyz", vector.tolist(), strict=True))
    if iron.motor_source == "current" and np.abs(iron.tuned_motor_mgauss).max() > _LEAST_MOTOR:
        found["motor_current"] = dict(zip("xyz", iron.tuned_motor_mgauss.tolist(), strict=True))
    known = [Cause(effect, values, {}, 1.0, ()) for effect, values in found.items()]
    return [*settings_of(known), *causes]


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
