"""Linear algebra of fits: a step of Gauss and Newton, what it leaves in doubt, and normal equations of sets.

Derivatives of all candidates go through the simulation once; sets are small algebra. With columns J of all
candidates beside the nuisances and the whitened residual r, a set S of them takes

    c_S^T A_SS^-1 c_S

off the sum of squares, A and c being J^T J and J^T r with the nuisances eliminated (their prior included).
The columns are kept, so that how far blocks contradict each other costs no new pass either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray

# How often what leaves its room is looked for again.
_ACTIVE = 3
RIDGE = 1e-9
# Columns shorter than this change nothing.
_NOTHING = 1e-9


def bridge(valid: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Map each row to itself or to the last valid one before; None where all are valid."""
    if valid.all() or not valid.any():
        return None
    last = np.maximum.accumulate(np.where(valid, np.arange(valid.size), -1))
    return np.where(last < 0, int(np.argmax(valid)), last)


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


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Hold what a set of columns explains: gain in the sum of squares, its own values and the nuisances'
    (K,)."""

    gain: float
    values: FloatArray
    nuisances: FloatArray


class BlockNormal:
    """Hold the normal equations of columns (nuisances first) of a recording in blocks."""

    def __init__(
        self, columns: FloatArray, residual: FloatArray, block: NDArray[np.int64], nuisances: int,
        precision: FloatArray, offset: FloatArray, usual: FloatArray, loose: NDArray[np.bool_],
    ) -> None:  # fmt: skip
        """Sum up columns (n, P) and a residual (n,); keep both, and the blocks (n,), which do not decrease.

        `precision` (K, K) is the nuisances' prior, `offset` (K,) its mean less where they stand. `usual` (P
        - K,) are sizes that the other columns' values have at most: what the recording does not tell stays
        within them. `loose` (K,) tells the nuisances that only this recording knows.
        """
        self.nuisances = nuisances
        self._loose = np.flatnonzero(loose)
        length = np.sqrt(np.einsum("np,np->p", columns, columns))
        self.size = np.where(length > _NOTHING, length, 1.0)
        # Sums block by block of all pairs would take more than the columns themselves; a ratio of scatters
        # needs no sixteen digits.
        self._columns, self._residual = columns.astype(np.float32), residual
        self._starts = np.flatnonzero(np.diff(block, prepend=block[:1] - 1))
        scale = self.size[:nuisances]
        total = columns.T @ columns / np.outer(self.size, self.size)
        self._right = columns.T @ residual / self.size
        total[:nuisances, :nuisances] += precision / np.outer(scale, scale)
        self._right[:nuisances] += precision @ offset / scale
        n = nuisances
        total[np.diag_indices_from(total)] += RIDGE
        place = np.arange(n, len(total))
        total[place, place] += (usual * self.size[n:]) ** -2.0
        self._total = total
        # What the nuisances take away of each column.
        self._through = np.linalg.solve(total[:n, :n], total[:n, n:])
        self._reduced = total[n:, n:] - total[n:, :n] @ self._through
        self._score = self._right[n:] - self._through.T @ self._right[:n]
        self.null_gain = (
            float(self._right[:n] @ np.linalg.solve(total[:n, :n], self._right[:n])) if n else 0.0
        )

    def gains(self, sets: Sequence[NDArray[np.int64]]) -> FloatArray:
        """Return what each set of columns (counted behind the nuisances) takes off the sum of squares."""
        out, sizes = np.zeros(len(sets)), np.array([own.size for own in sets])
        for size in np.unique(sizes[sizes > 0]).tolist():
            which = np.flatnonzero(sizes == size)
            own = np.array([sets[i] for i in which.tolist()])
            A, c = self._reduced[own[:, :, None], own[:, None, :]], self._score[own]
            out[which] = np.sum(c * np.linalg.solve(A, c[:, :, None])[:, :, 0], axis=1)
        return out

    def solve(self, own: NDArray[np.int64]) -> Solution:
        """Return what a set of columns explains, and with which values."""
        n = self.nuisances
        A, c = self._reduced[np.ix_(own, own)], self._score[own]
        values = np.linalg.solve(A, c) if own.size else np.zeros(0)
        nuisances = np.linalg.solve(self._total[:n, :n], self._right[:n] - self._total[:n, n + own] @ values)
        return Solution(float(c @ values), values / self.size[n + own], nuisances / self.size[:n])

    def overdispersion_of(self, own: NDArray[np.int64], of: NDArray[np.int64]) -> float:
        """Return by how much blocks contradict each other about some columns `of` a set, 1 where they do not.

        Of a model that is true the scores of blocks scatter as the normal matrix says: the ratio is the
        factor by which errors that last for seconds make every gain look larger than it is (the design
        effect of cluster sampling; White, Econometrica 48, 1980).
        """
        n = self.nuisances
        solution = self.solve(own)
        values = np.zeros(self.size.size)
        values[:n] = solution.nuisances * self.size[:n]
        values[n + own] = solution.values * self.size[n + own]
        rest = np.setdiff1d(own, of)
        # What is known from elsewhere counts as known: blocks cannot contradict it.
        beside = np.concatenate([self._loose, n + rest])
        A = self._total
        through = np.linalg.solve(A[np.ix_(beside, beside)], A[np.ix_(beside, n + of)])
        inner = A[np.ix_(n + of, n + of)] - A[np.ix_(n + of, beside)] @ through
        left = self._residual - self._columns @ (values / self.size)

        def scores(some: NDArray[np.int64]) -> FloatArray:
            return np.add.reduceat(self._columns[:, some] * left[:, None], self._starts) / self.size[some]

        own_scores = scores(n + of) - scores(beside) @ through
        scatter = np.einsum("bi,ij,bj->", own_scores, np.linalg.inv(inner), own_scores)
        return max(float(scatter) / of.size, 1.0)
