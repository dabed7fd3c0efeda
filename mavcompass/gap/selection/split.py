"""Cut a recording in blocks: most of them to choose and fit, some held out to measure on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

BLOCK_S = 5.0
GUARD_S = 0.5
WINDOW_S = 0.3
_HELD_OUT_OF = 4
_FEWEST_BLOCKS = 12
_SEED = 20260101

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Hold which rows choose and fit (`train`) and which are held out (`test`), both (N,).

    `block` numbers the block of each row; `held` tells which blocks are held out. Rows within the guard
    of a held-out block belong to neither.
    """

    block: NDArray[np.int64]
    held: Mask
    train: Mask
    test: Mask


def split_blocks(time_s: FloatArray, valid: Mask) -> Split:
    """Hold out one block of every four, at a place that a fixed generator draws.

    A regular pattern would fall into step with a procedure that turns and dwells in a fixed rhythm. Two
    neighbours would be too long to know the attitude between. Short recordings get shorter blocks.
    """
    length = _block_s(time_s)
    block = np.floor((time_s - time_s[0]) / length).astype(np.int64)
    count = int(block[-1]) + 1
    held = np.zeros(count, dtype=np.bool_)
    rng = np.random.default_rng(_SEED)
    for first in range(0, count, _HELD_OUT_OF):
        place = first + int(rng.integers(_HELD_OUT_OF))
        if place and held[place - 1 : place].any():
            place += 1
        if place < count:
            held[place] = True
    return _masks(time_s, valid, block, held, min(GUARD_S, length / 5.0))


def with_windows(split: Split, time_s: FloatArray, valid: Mask, moments_s: list[float]) -> Split:
    """Give a narrow window about each moment to the training rows, where it lies in a held-out block.

    The training rows alone tell that something changes inside the block; the window halves the stretch in
    which it may be. A guard on both sides of the window leaves the held-out rows.
    """
    train, test = split.train.copy(), split.test.copy()
    for moment in moments_s:
        distance = np.abs(time_s - moment)
        train |= (distance < WINDOW_S) & valid
        test &= distance > WINDOW_S + 0.3 * GUARD_S
    return replace(split, train=train, test=test)


def probe(split: Split, time_s: FloatArray, moment_s: float) -> float | None:
    """Return the middle of the gap between training rows at a moment, or beside it; None where there is none.

    A change found right beside a gap may as well lie inside it: the rows at the edge are few.
    """
    rows = time_s[split.train]
    step = float(np.median(np.diff(time_s)))
    gaps = np.flatnonzero(np.diff(rows) > 0.5 * GUARD_S + 3.0 * step)
    for gap in gaps:
        if rows[gap] - WINDOW_S < moment_s < rows[gap + 1] + WINDOW_S:
            return float(0.5 * (rows[gap] + rows[gap + 1]))
    return None


def _block_s(time_s: FloatArray) -> float:
    return max(min(BLOCK_S, float(time_s[-1] - time_s[0]) / _FEWEST_BLOCKS), 1e-3)


def _masks(time_s: FloatArray, valid: Mask, block: NDArray[np.int64], held: Mask, guard_s: float) -> Split:
    test = held[block]
    train = ~test
    edges = np.flatnonzero(np.diff(test.astype(np.int8)))
    for edge in edges:
        boundary = 0.5 * (time_s[edge] + time_s[edge + 1])
        train &= ~((np.abs(time_s - boundary) < guard_s) & ~test)
    return Split(block, held, train & valid, test & valid)
