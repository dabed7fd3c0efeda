"""Weighted least squares over a chain of states and a few constants: what a smoother solves.

Each state x_k knows only its neighbours, every one the constants c. The normal matrix is block tridiagonal
with a border: odd-even reduction (`Reduced`; scipy's banded solvers are no faster here, and take a sixth of a
second to load) and Schur's complement solve it, and give the covariance of any states. With normal errors the
solution is that of Rauch, Tung and Striebel's smoother.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.tables import usual


class Reduced:
    """Reduce a block tridiagonal, positive definite matrix: every other state is eliminated, again and again.

    Cyclic reduction: Golub and Van Loan, Matrix Computations, section 4.5.4. All states of a round go at
    once, so that hundreds of them are ten rounds of numpy's.
    """

    def __init__(self, diagonal: FloatArray, beside: FloatArray) -> None:
        """Take the blocks on the diagonal (K, n, n) and those right of them (K - 1, n, n)."""
        # Those of odd number go; of one state alone, that.
        gone = diagonal[1::2] if len(diagonal) > 1 else diagonal
        self._inverse = np.asarray(np.linalg.inv(gone))
        self.log_determinant = float(np.linalg.slogdet(gone)[1].sum())
        self._rest: Reduced | None = None
        if len(diagonal) == 1:
            return
        # The last eliminated state may have none after it.
        before, after = beside[::2].transpose(0, 2, 1), beside[1::2]
        last = len(after)
        # What a neighbour's value moves the eliminated state by.
        self._by_before, self._by_after = self._inverse @ before, self._inverse[:last] @ after
        even = diagonal[::2].copy()
        even[: len(before)] -= before.transpose(0, 2, 1) @ self._by_before
        even[1 : last + 1] -= after.transpose(0, 2, 1) @ self._by_after
        # Rounding must not make them uneven.
        even = 0.5 * (even + even.transpose(0, 2, 1))
        self._rest = Reduced(even, -(before[:last].transpose(0, 2, 1) @ self._by_after))
        self.log_determinant += self._rest.log_determinant

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for right hand sides (K, n, C)."""
        if self._rest is None:
            return np.asarray(self._inverse @ right)
        odd, even, last = right[1::2], right[::2].copy(), len(self._by_after)
        even[: len(odd)] -= self._by_before.transpose(0, 2, 1) @ odd
        even[1 : last + 1] -= self._by_after.transpose(0, 2, 1) @ odd[:last]
        even = self._rest.solve(even)
        out = np.empty_like(right, dtype=np.float64)
        out[::2], out[1::2] = even, self._inverse @ odd - self._by_before @ even[: len(odd)]
        out[1 : 2 * last : 2] -= self._by_after @ even[1 : last + 1]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Hold the solution of a chain.

    Attributes:
        states: (K, n). constants: (m,); constants_covariance: (m, m).
        deviance: minus twice the logarithm of the likelihood of all that was added, up to a constant.
    """

    states: FloatArray
    constants: FloatArray
    constants_covariance: FloatArray
    deviance: float
    _reduced: Reduced
    _bent: FloatArray

    def covariance_with(self, which: NDArray[np.int64], sums: FloatArray) -> FloatArray:
        """Return the covariance of all states with sums of the first elements of some, (K, n, k).

        The sums have weights (M, count, k).
        """
        length, width = self.states.shape
        right = np.zeros((length, width, sums.shape[2]))
        right[which, : sums.shape[1]] = sums
        alone = self._reduced.solve(right)
        bent = self._bent.reshape(length, width, -1)
        shared = np.tensordot(bent[which, : sums.shape[1]], sums, ((0, 1), (0, 1)))
        return np.asarray(alone + bent @ (self.constants_covariance @ shared))


class Chain:
    """Collect equations J x = y of weight w, and solve them.

    Derivatives are (K, rows, n) by the states and (K, rows, m) by the constants, or None where the constants
    have no part; values and weights are (K, rows).
    """

    def __init__(self, length: int, width: int, constants: int) -> None:
        self._diagonal = np.zeros((length, width, width))
        self._beside = np.zeros((length - 1, width, width))
        self._border = np.zeros((length, width, constants))
        self._corner = np.zeros((constants, constants))
        self._right = np.zeros((length, width))
        self._corner_right = np.zeros(constants)
        self._squares = 0.0
        self._log_weights = 0.0

    def copy(self) -> Chain:
        """Return a chain to which more can be added."""
        return copy.deepcopy(self)

    def add(
        self, at: slice, J: FloatArray, c: FloatArray | None, y: FloatArray, w: FloatArray, share: float = 1.0
    ) -> None:
        """Add equations of single states: J[k] x_k + c[k] c = y[k]; each is news but for a `share`."""
        w = share * w
        weighted = (J * w[:, :, None]).transpose(0, 2, 1)
        self._diagonal[at] += weighted @ J
        self._right[at] += np.einsum("kim,km->ki", weighted, y)
        if c is not None:
            self._border[at] += weighted @ c
        self._count(c, y, w, share)

    def link(
        self, before: FloatArray, after: FloatArray, c: FloatArray | None, y: FloatArray, w: FloatArray
    ) -> None:
        """Add equations of all neighbours: before[k] x_k + after[k] x_(k+1) + c[k] c = y[k]."""
        first, second = (
            (before * w[:, :, None]).transpose(0, 2, 1),
            (after * w[:, :, None]).transpose(0, 2, 1),
        )
        self._diagonal[:-1] += first @ before
        self._diagonal[1:] += second @ after
        self._beside += first @ after
        self._right[:-1] += np.einsum("kim,km->ki", first, y)
        self._right[1:] += np.einsum("kim,km->ki", second, y)
        if c is not None:
            self._border[:-1] += first @ c
            self._border[1:] += second @ c
        self._count(c, y, w)

    def lasting(self, state: int, keep: FloatArray, w: FloatArray, first: float) -> None:
        """Add a first-order process of one state: x_(k+1) = keep[k] x_k of weight w[k], x_0 = 0 of weight
        `first`."""
        own = self._diagonal[:, state, state]
        own[:-1] += keep * keep * w
        own[1:] += w
        own[0] += first
        self._beside[:, state, state] -= keep * w
        self._log_weights += float(np.log(w).sum()) + math.log(first)

    def know(self, mean: FloatArray, sigma: FloatArray) -> None:
        """Add what is known of the constants, (m,) each."""
        self._corner += np.diag(sigma**-2.0)
        self._corner_right += mean * sigma**-2.0
        self._squares += float(np.sum((mean / sigma) ** 2))
        self._log_weights -= 2.0 * float(np.log(sigma).sum())

    def _count(self, c: FloatArray | None, y: FloatArray, w: FloatArray, share: float = 1.0) -> None:
        if c is not None:
            weighted = c * w[:, :, None]
            self._corner += np.einsum("kmi,kmj->ij", weighted, c)
            self._corner_right += np.einsum("kmi,km->i", weighted, y)
        self._squares += float((w * y * y).sum())
        self._log_weights += share * float(np.log(w[w > 0.0] / share).sum())

    def solve(self) -> Solved:
        """Solve for states and constants."""
        length, width, constants = self._border.shape
        reduced = Reduced(self._diagonal, self._beside)
        both = reduced.solve(np.concatenate([self._right[:, :, None], self._border], axis=2))
        both = both.reshape(length * width, 1 + constants)
        bent = both[:, 1:]
        border = self._border.reshape(length * width, constants)
        schur = self._corner - border.T @ bent
        covariance = np.asarray(np.linalg.inv(schur))
        found = covariance @ (self._corner_right - border.T @ both[:, 0])
        states = both[:, 0] - bent @ found
        misfit = self._squares - float(self._right.ravel() @ states) - float(self._corner_right @ found)
        determinants = reduced.log_determinant + float(np.linalg.slogdet(schur)[1])
        return Solved(
            states.reshape(length, width), found, covariance, misfit + determinants - self._log_weights,
            reduced, bent,
        )  # fmt: skip


def silences(clock: FloatArray) -> NDArray[np.bool_]:
    """Tell which of the steps between times (N,) are far longer than usual, (N - 1,)."""
    step = np.diff(clock)
    return np.asarray(step > usual.knots.silence * np.median(step))


def knots_of(clock: FloatArray) -> FloatArray:
    """Return even knots, with one on each side of every silence and none in it."""
    span = float(clock[-1] - clock[0])
    count = max(round(span / max(usual.knots.apart_s, span / usual.knots.most)), usual.knots.fewest) + 1
    even = np.linspace(clock[0], clock[-1], count)
    silent = np.flatnonzero(silences(clock))
    first, last = clock[silent], clock[silent + 1]
    # Not beside an edge either: neighbours must not be too alike.
    near = 0.25 * (even[1] - even[0])
    for begin, end in zip(first, last, strict=True):
        even = even[(even < begin - near) | (even > end + near)]
    return np.unique(np.concatenate([clock[:1], even, first, last, clock[-1:]]))
