"""The end of what a sensor can show: readings that pile up there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# Of a turn's steps the highest is shown so many times as often as the next: acos is a root there. And chance.
_HIGHEST, _CHANCE_SIGMAS, _HINT_SIGMAS = 1.0 / (math.sqrt(2.0) - 1.0), 5.0, 3.0
# Readings that tell no step of their own are put into no finer ones: half of a usual sensor's.
_FINE_MGAUSS = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Hold how readings (N, 3) pile up at one end of an axis, counted in steps.

    Attributes:
        size_mgauss: the size of the last of them. rows: those in the last step, (N,).
        last, next, all: how many different readings lie in the last step, in the one below it that has some,
            and in all.
    """

    size_mgauss: float
    rows: NDArray[np.bool_]
    last: int
    next: int
    all: int

    @property
    def rests(self) -> bool:
        """Tell whether more lie there than beyond any value of a turn on a side of its middle."""
        return 2 * self.last > self.all

    def piles_up(self, sigmas: float) -> bool:
        """Tell whether a field that turns would not show its highest value as often, but for chance."""
        usual = _HIGHEST * self.next
        return self.last > usual + sigmas * math.sqrt(self.last + _HIGHEST * usual)


def _ends(values: FloatArray, step: float) -> Iterator[_End]:
    """Count readings (N, 3) at both ends of each axis; a repeated one counts once.

    Values are counted in steps: where a correction was undone, and another after it, hardly two are equal.
    """
    values = np.round(values, 3)
    finite = np.isfinite(values).all(axis=1)
    once: NDArray[np.intp] | None = None
    for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
        shown = sign * values[:, axis]
        highest = float(shown[finite].max(initial=-np.inf))
        below = np.floor((highest - shown) / step + 1e-6)
        # So few are chance: no need to look which of them are repeated.
        if (below == 0.0).sum() <= _HINT_SIGMAS**2:
            continue
        if once is None:
            once = np.flatnonzero(finite)[np.unique(values[finite], axis=0, return_index=True)[1]]
        _, count = np.unique(below[once], return_counts=True)
        yield _End(highest, below == 0.0, int(count[0]), int(count[1]) if count.size > 1 else 0, once.size)


def saturated(values: FloatArray, step: float = 0.0) -> NDArray[np.bool_]:
    """Mark readings (N, 3) at the end of what the sensor can show, on any axis, (N,).

    A field that turns shows its highest value 2.4 times as often as the next below, at most; what the sensor
    cuts off piles up there. Less than half of a turn lies beyond a value on a side of its middle: where more
    readings do, the axis rests.
    """
    at_end = np.zeros(len(values), dtype=bool)
    for end in _ends(values, max(step, 1e-3)):
        if end.piles_up(_CHANCE_SIGMAS) and not end.rests:
            at_end |= end.rows
    return at_end


def may_saturate(values: FloatArray, step: float = 0.0) -> bool:
    """Tell whether the largest of readings (N, 3) pile up as at a sensor's limit, resting or not.

    Where they do not, no limit cut them off. A limit in readings whose correction was undone is as wide as
    the rounding of three axes made it.
    """
    step = max(1.5 * step, _FINE_MGAUSS)
    ends = list(_ends(values, step))
    top = float(np.abs(values[np.isfinite(values).all(axis=1)]).max(initial=0.0))
    return any(end.piles_up(_HINT_SIGMAS) and end.size_mgauss > top - 3.0 * step for end in ends)
