"""The rules of writing compass parameters, read from `params/ardupilot.toml` and `params/px4.toml`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.errors import MavCompassError
from mavcompass.installation.parts import params_path

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ParameterRules:
    """Hold one autopilot's rules.

    Attributes:
        general, per_compass: what to read of the compasses: whole names, and what each of them has.
        vehicle: what to read of the vehicle itself, for turning and judging it.
        protected, needs_reboot: patterns of names that are never written, or work after a start.
        offset_usual_mgauss: per axis; beyond it a person is told. offset_largest_mgauss: length.
        offset_instead_of_zero_mgauss: 0 where zero offsets mean nothing special.
        diagonal, off_diagonal: ranges of the matrix. scale: range, None where there is no scale.
        motor_largest_mgauss: per axis.
    """

    general: tuple[str, ...]
    per_compass: tuple[str, ...]
    vehicle: tuple[str, ...]
    protected: tuple[str, ...]
    needs_reboot: tuple[str, ...]
    offset_usual_mgauss: float
    offset_largest_mgauss: float
    offset_instead_of_zero_mgauss: float
    diagonal: Range
    off_diagonal: Range
    scale: Range | None
    motor_largest_mgauss: float

    def is_protected(self, name: str) -> bool:
        """Tell whether a parameter is the firmware's own to keep."""
        return _matches(name, self.protected)

    def wants_reboot(self, name: str) -> bool:
        """Tell whether a parameter takes effect at the next start only."""
        return _matches(name, self.needs_reboot)


@lru_cache
def parameter_rules(autopilot: str) -> ParameterRules:
    """Read the rules of "ardupilot" or "px4"; raises MavCompassError where the file is damaged."""
    path = params_path(f"{autopilot}.toml")
    try:
        return _rules(tomllib.loads(path.read_text(encoding="utf-8")))
    except (ValueError, KeyError, TypeError) as error:
        raise MavCompassError(
            f"The rules in {path} cannot be used ({type(error).__name__}: {error}).",
            "Correct the file, or install mavcompass again.",
        ) from error


def _rules(document: dict[str, Any]) -> ParameterRules:
    read, write, offset, matrix = (document[key] for key in ("read", "write", "offset", "matrix"))
    return ParameterRules(
        general=tuple(read["general"]),
        per_compass=tuple(read["per_compass"]),
        vehicle=tuple(read["vehicle"]),
        protected=tuple(write["protected"]),
        needs_reboot=tuple(write["needs_reboot"]),
        offset_usual_mgauss=float(offset["usual_mgauss"]),
        offset_largest_mgauss=float(offset["largest_mgauss"]),
        offset_instead_of_zero_mgauss=float(offset["instead_of_zero_mgauss"]),
        diagonal=_range(matrix["diagonal"]),
        off_diagonal=_range(matrix["off_diagonal"]),
        scale=_range(document["scale"]["applied"]) if "scale" in document else None,
        motor_largest_mgauss=float(document["motor"]["largest_mgauss"]),
    )


def check_correction(
    correction: FieldCorrection, rules: ParameterRules, label: str, offset_largest_mgauss: float
) -> tuple[list[str], list[str]]:
    """Judge a correction by an autopilot's rules: sentences why not to write it, and sentences to know."""
    refusals: list[str] = []
    length = math.hypot(*correction.offsets_mgauss)
    if not length <= offset_largest_mgauss:
        refusals.append(
            f"{label}: the offsets are {length:.0f} mGauss long and the vehicle takes"
            f" {offset_largest_mgauss:.0f}. Move the compass away from iron and currents."
        )
    refusals += _out_of_range(correction.diagonals, rules.diagonal, f"{label}: a diagonal")
    refusals += _out_of_range(correction.off_diagonals, rules.off_diagonal, f"{label}: an off-diagonal")
    if not refusals and np.linalg.eigvalsh(correction.matrix)[0] <= 0.0:
        refusals.append(f"{label}: the matrix is not positive: it would turn the field over.")
    if rules.scale is not None:
        refusals += _out_of_range([correction.scale], rules.scale, f"{label}: the scale")
    motor = (-rules.motor_largest_mgauss, rules.motor_largest_mgauss)
    refusals += _out_of_range(correction.motor_mgauss, motor, f"{label}: a motor term")
    remarks = []
    if not refusals and max(map(abs, correction.offsets_mgauss)) > rules.offset_usual_mgauss:
        remarks.append(
            f"{label}: an offset is beyond the usual {rules.offset_usual_mgauss:.0f} mGauss; look for iron"
            " or a magnet near the compass."
        )
    return refusals, remarks


def _out_of_range(values: Iterable[float], limits: Range, what: str) -> list[str]:
    low, high = limits
    return [
        f"{what} of {value:g} is outside {low:g} to {high:g}." for value in values if not low <= value <= high
    ]


def _range(pair: list[float]) -> Range:
    low, high = (float(end) for end in pair)
    if not low < high:
        raise ValueError(f"a range goes from low to high, not {pair}")
    return low, high


def _matches(name: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)
