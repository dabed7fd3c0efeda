"""The steps of a file's numbers: whole milligauss, milli-g and milliradians are MAVLink's, cut toward zero.

A file says nothing of how its numbers were made. Whole numbers of which all steps occur are a format's
resolution, whatever the sensor's. Cutting toward zero makes the step about zero twice as wide as the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.track import Series
from mavcompass.units import STANDARD_GRAVITY_MPS2

FIELD_STEP_MGAUSS = 1.0
FORCE_STEP_MPS2 = 1e-3 * STANDARD_GRAVITY_MPS2
RATE_STEP_RADPS = 1e-3
_FEWEST_LEVELS = 6
# Numbers are printed with few decimals.
_NEAR = 0.02
_FEWEST_IN_A_STEP = 5
_WIDER = 1.5
_SURE = 4.0


@dataclass(frozen=True, slots=True)
class Steps:
    """Hold the steps of a format, 0 where a sensor's numbers have none of its own; `cut`: toward zero."""

    field_mgauss: float
    force_mps2: float
    rate_radps: float
    cut: bool


def format_steps(field: Series, force: Series | None, rate: Series | None) -> Steps:
    """Look for whole milligauss (N, 3), milli-g (N, 3) and milliradians per second (N, 3)."""
    found: list[float] = []
    columns: list[NDArray[np.int64]] = []
    usual = (FIELD_STEP_MGAUSS, FORCE_STEP_MPS2, RATE_STEP_RADPS)
    for series, step in zip((field, force, rate), usual, strict=True):
        whole = None if series is None else whole_steps(series.values, step)
        found.append(0.0 if whole is None else step)
        if whole is not None:
            columns.extend(whole.T)
    return Steps(found[0], found[1], found[2], cut_toward_zero(columns))


def whole_steps(values: FloatArray, step: float) -> NDArray[np.int64] | None:
    """Return values as whole numbers of a step; None where they are none, or of a coarser step."""
    counts = values / step
    whole = np.round(counts)
    if not np.isfinite(counts).all() or bool((np.abs(counts - whole) > _NEAR).any()):
        return None
    numbers = whole.astype(np.int64)
    levels = np.unique(numbers)
    if levels.size < _FEWEST_LEVELS or int(np.gcd.reduce(np.diff(levels))) != 1:
        return None
    return numbers


def cut_toward_zero(columns: Iterable[NDArray[np.int64]]) -> bool:
    """Tell by how often zero occurs beside its neighbours whether numbers were cut toward zero, not rounded.

    Rounded numbers, about zero, have logarithms of their counts on a parabola: n_0 = n_1 (n_1 / n_2)^(1/3).
    """
    seen, expected = 0.0, 0.0
    for column in columns:
        zero, one, two = (float(np.count_nonzero(np.abs(column) == k)) for k in range(3))
        if min(one, two) / 2.0 < _FEWEST_IN_A_STEP:
            continue
        seen += zero
        expected += 0.5 * one * max(one / two, 1.0) ** (1.0 / 3.0)
    return seen > _WIDER * expected and seen - expected > _SURE * math.sqrt(max(expected, 1.0))
