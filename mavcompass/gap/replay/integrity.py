"""Exact traces in the numbers themselves: repeated readings and coarse steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

_FEWEST_LEVELS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Hold what the numbers show.

    `stale_share` is the share of repeats, `stale` which rows repeat, `held_s` how long each fresh reading
    stayed from
    `fresh_s` on, `step_mgauss` the step of the numbers (0: none seen).
    """

    stale_share: float
    stale: NDArray[np.bool_]
    held_s: FloatArray
    fresh_s: FloatArray
    step_mgauss: float


def inspect(field_mgauss: FloatArray, valid: NDArray[np.bool_], time_s: FloatArray) -> Trace:
    """Look for repeats and a lattice in readings (N, 3) at some times (N,), before any averaging."""
    same = np.concatenate([[False], (np.diff(field_mgauss, axis=0) == 0.0).all(axis=1)]) & valid
    share = float(same.sum()) / max(int(valid.sum()), 1)
    # How long each fresh reading was repeated: readings that are missing repeat nothing.
    fresh = np.flatnonzero(~same)
    last = np.append(fresh[1:], time_s.size) - 1
    return Trace(share, same, time_s[last] - time_s[fresh], time_s[fresh], _lattice(field_mgauss[valid]))


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
