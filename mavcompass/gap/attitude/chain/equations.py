"""Weighted least squares over a chain of states and a few constants: what a smoother solves.

Each state x_k knows only its neighbours, every one the constants c. The normal matrix is block tridiagonal
with a border: odd-even reduction (`Reduced`) and Schur's complement solve it, and give the covariance of any
states. With normal errors the solution is that of Rauch, Tung and Striebel's smoother.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.chain.tridiagonal import Reduced


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

    def covariance(self, which: NDArray[np.int64], count: int) -> FloatArray:
        """Return the joint covariance of the first elements of some states (M,), (M count, M count)."""
        length, width = self.states.shape
        rows = (which[:, None] * width + np.arange(count)).ravel()
        unit = np.zeros((length * width, rows.size))
        unit[rows, np.arange(rows.size)] = 1.0
        bent = self._bent[rows]
        alone = self._reduced.products(unit.reshape(length, width, rows.size))
        return np.asarray(alone + bent @ self.constants_covariance @ bent.T)

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
