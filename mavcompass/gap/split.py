"""Cut a recording in blocks: most of them to choose and fit, some held out to measure on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

BLOCK_S = 5.0
GUARD_S = 0.5
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

    def halves(self) -> tuple[Mask, Mask]:
        """Cut the training rows in two halves of alternating blocks, to check one with the other."""
        order = np.cumsum(~self.held)[self.block]
        return self.train & (order % 2 == 0), self.train & (order % 2 == 1)


def split_blocks(time_s: FloatArray, valid: Mask) -> Split:
    """Hold out one block of every four, at a place that a fixed generator draws.

    A regular pattern would fall into step with a procedure that turns and dwells in a fixed rhythm.
    Short recordings get shorter blocks.
    """
    span = float(time_s[-1] - time_s[0])
    length = max(min(BLOCK_S, span / _FEWEST_BLOCKS), 1e-3)
    block = np.floor((time_s - time_s[0]) / length).astype(np.int64)
    count = int(block[-1]) + 1
    held = np.zeros(count, dtype=np.bool_)
    rng = np.random.default_rng(_SEED)
    for first in range(0, count, _HELD_OUT_OF):
        place = first + int(rng.integers(_HELD_OUT_OF))
        if place < count:
            held[place] = True
    return _masks(time_s, valid, block, held, min(GUARD_S, length / 5.0))


def without_held_block(split: Split, time_s: FloatArray, valid: Mask, moments_s: list[float]) -> Split:
    """Give the held-out blocks in which something changes to the training rows.

    The training rows alone tell that the change lies there; where exactly, only the block itself can.
    """
    held = split.held.copy()
    for moment in moments_s:
        near = np.abs(time_s - moment) < 1.5 * GUARD_S
        held[np.unique(split.block[near])] = False
    if held.sum() < 2 or np.array_equal(held, split.held):
        return split
    return _masks(time_s, valid, split.block, held, GUARD_S)


def _masks(time_s: FloatArray, valid: Mask, block: NDArray[np.int64], held: Mask, guard_s: float) -> Split:
    test = held[block]
    train = ~test
    edges = np.flatnonzero(np.diff(test.astype(np.int8)))
    for edge in edges:
        boundary = 0.5 * (time_s[edge] + time_s[edge + 1])
        train &= ~((np.abs(time_s - boundary) < guard_s) & ~test)
    return Split(block, held, train & valid, test & valid)


def whole(split: Split, valid: Mask) -> Split:
    """Return a split that fits on every valid row: for what is measured on another recording."""
    return replace(split, train=valid, test=np.zeros_like(valid))
