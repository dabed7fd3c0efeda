"""Exact traces in the numbers themselves: repeated readings and coarse steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

if TYPE_CHECKING:
    from mavcompass.gap.replay import Replay

_FEWEST_LEVELS = 6
# MAVLink's messages and ArduPilot's parameters count whole milligauss.
_USUAL_STEP_MGAUSS = 1.0 + 1e-6
_REPEATS_WORTH_NAMING = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Hold what the numbers show: the share of repeats, which rows repeat, the step (0: none seen)."""

    stale_share: float
    stale: NDArray[np.bool_]
    step_mgauss: float


def inspect(field_mgauss: FloatArray, valid: NDArray[np.bool_]) -> Trace:
    """Look for repeats and a lattice in raw readings (N, 3), before any averaging."""
    same = np.concatenate([[False], (np.diff(field_mgauss, axis=0) == 0.0).all(axis=1)]) & valid
    share = float(same.sum()) / max(int(valid.sum()), 1)
    return Trace(share, same, _lattice(field_mgauss[valid]))


def _lattice(field: FloatArray) -> float:
    """Return the step whose multiples all differences are, the same on all axes; 0 where there is none.

    An axis that hardly changes (the vertical one in level turns) has too few levels to tell a step, but
    enough to refute one.
    """
    gaps, steps = [], []
    for axis in range(3):
        levels = np.unique(np.round(field[:, axis], 9))
        if levels.size > 0.5 * len(field):
            return 0.0
        gaps.append(np.diff(levels))
        if levels.size >= _FEWEST_LEVELS:
            steps.append(float(np.quantile(gaps[-1], 0.05)))
    if not steps or min(steps) <= 0.0 or max(steps) > 1.05 * min(steps):
        return 0.0
    step = float(np.median(steps))
    multiples = np.concatenate(gaps) / step
    off = np.abs(multiples - np.round(multiples))
    allowed = 0.02 * np.maximum(
        1.0, np.sqrt(np.concatenate([np.full(g.size, g.max(initial=0.0)) for g in gaps]) / step)
    )
    return step if bool((off <= allowed).all()) else 0.0


def names_stale(replay: Replay, baseline: Replay | None) -> bool:
    """Tell whether the repeats are an effect: more than by chance, than the baseline's, than telemetry's."""
    if replay.telemetry:
        return False
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    expected = nominal.stale_share if nominal is not None else 0.0
    coarse = found.step_mgauss > 0.0 or replay.resolution_mgauss > 0.0
    if coarse and (baseline is None or _steps_of(replay) != _steps_of(baseline)):
        # Coarse numbers repeat by chance, and no baseline tells how often.
        return False
    count = found.stale.size
    noise = math.sqrt(max(expected * (1.0 - expected), 1.0 / count) / count)
    return found.stale_share > max(_REPEATS_WORTH_NAMING, expected + 5.0 * noise)


def _steps_of(replay: Replay) -> tuple[float, float]:
    return replay.trace.step_mgauss, replay.resolution_mgauss


def names_step(replay: Replay, baseline: Replay | None, noise_mgauss: float) -> bool:
    """Tell whether the step of the numbers is an effect: coarse beside the noise, and not nominal."""
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    if found.step_mgauss <= 0.0 or replay.resolution_mgauss > 0.0:
        return False
    if found.step_mgauss <= _USUAL_STEP_MGAUSS:
        return False
    if nominal is not None and nominal.step_mgauss > 0.9 * found.step_mgauss:
        return False
    return found.step_mgauss > 0.5 * noise_mgauss
