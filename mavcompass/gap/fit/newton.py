"""The linear algebra of one step of Gauss and Newton, of what it leaves in doubt, and of rows without a
reading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# How often what leaves its room is looked for again.
_ACTIVE = 3


def bridge(valid: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Map each row to itself or to the last valid one before; None where all are valid."""
    if valid.all() or not valid.any():
        return None
    last = np.maximum.accumulate(np.where(valid, np.arange(valid.size), -1))
    return np.where(last < 0, int(np.argmax(valid)), last)


def moved(
    x: list[FloatArray],
    step: FloatArray,
    free: list[NDArray[np.int64]],
    bounds: list[tuple[FloatArray, FloatArray]],
) -> list[FloatArray]:
    """Add a step to the free parameters; keep all inside their bounds."""
    out, at = [], 0
    for value, index, (low, high) in zip(x, free, bounds, strict=True):
        trial = value.copy()
        trial[index] += step[at : at + index.size]
        at += index.size
        out.append(np.clip(trial, low, high))
    return out


def room(
    x: list[FloatArray], free: list[NDArray[np.int64]], bounds: list[tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Return how far the free parameters may go down and up, (k,) each."""
    down = [low[index] - value[index] for value, index, (low, _) in zip(x, free, bounds, strict=True)]
    up = [high[index] - value[index] for value, index, (_, high) in zip(x, free, bounds, strict=True)]
    return np.concatenate(down), np.concatenate(up)


def solve_within(
    normal: FloatArray, gradient: FloatArray, damping: float, down: FloatArray, up: FloatArray
) -> FloatArray:
    """Solve the damped normal equations; what would leave its room goes to the end of it, and the others as
    is best beside that."""
    step = solve(normal, gradient, damping)
    fixed = np.zeros(step.size, dtype=np.bool_)
    for _ in range(_ACTIVE):
        beyond = ~fixed & ((step < down) | (step > up))
        if not beyond.any():
            break
        fixed |= beyond
        step[fixed] = np.clip(step, down, up)[fixed]
        rest = ~fixed
        if not rest.any():
            break
        beside = gradient[rest] - normal[np.ix_(rest, fixed)] @ step[fixed]
        step[rest] = solve(normal[np.ix_(rest, rest)], beside, damping)
    return step


def solve(normal: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """Solve the damped normal equations, scaled to unit diagonal."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += damping + 1e-12
    return np.asarray(np.linalg.solve(scaled, gradient / size) / size)


def invert(normal: FloatArray) -> FloatArray:
    """Return the covariance, without the directions that the data do not tell."""
    told = np.diag(normal) > 0.0
    size = np.where(told, np.sqrt(np.maximum(np.diag(normal), 1e-300)), 1.0)
    return np.asarray(np.linalg.pinv(normal / np.outer(size, size), rcond=1e-10) / np.outer(size, size))


def cluster_covariance(
    columns: FloatArray, residual: FloatArray, block: NDArray[np.int64], precision: FloatArray
) -> FloatArray:
    """Return the covariance (K, K) of a fit whose whitened errors may last for a block.

    Columns (n, K) and the residual (n,) are of one fit, `block` (n,) labels what may err together, and
    `precision` (K, K) is what is known beforehand. With A = J^T J + P it is A^-1 (sum_b s_b s_b^T + P) A^-1,
    s_b being a block's score J_b^T r_b (White, Econometrica 48, 1980; for clusters Liang and Zeger,
    Biometrika 73, 1986), and never less than A^-1 for any parameter: what errors that last add is told,
    but not that a few blocks agree by chance.
    """
    plain = invert(columns.T @ columns + precision)
    label = np.unique(block, return_inverse=True)[1]
    count = int(label.max(initial=0)) + 1
    if count < 2:
        return plain
    order = np.argsort(label, kind="stable")
    first = np.searchsorted(label[order], np.arange(count))
    scores = np.add.reduceat(columns[order] * residual[order, None], first, axis=0)
    lasting = plain @ (count / (count - 1.0) * scores.T @ scores + precision) @ plain
    sigma, least = (np.sqrt(np.maximum(np.diag(m), 0.0)) for m in (lasting, plain))
    wider = np.divide(np.maximum(sigma, least), sigma, out=np.ones_like(sigma), where=sigma > 0.0)
    return np.asarray(lasting * np.outer(wider, wider))
