"""Block tridiagonal systems, solved by odd-even reduction.

scipy has banded solvers, which are no faster here, and take a sixth of a second to load.
"""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray


class Reduced:
    """Reduce a block tridiagonal, positive definite matrix: every other state is eliminated, again and again.

    Cyclic reduction: Golub and Van Loan, Matrix Computations, section 4.5.4. All states of a round go at
    once, so that hundreds of them are ten rounds of numpy's.
    """

    def __init__(self, diagonal: FloatArray, beside: FloatArray) -> None:
        """Take the blocks on the diagonal (K, n, n) and those right of them (K - 1, n, n)."""
        self.log_determinant = 0.0
        self._rounds: list[_Round] = []
        while len(diagonal) > 1:
            odd = diagonal[1::2]
            one = _Round(np.asarray(np.linalg.inv(odd)), beside[::2].transpose(0, 2, 1), beside[1::2])
            self.log_determinant += float(np.linalg.slogdet(odd)[1].sum())
            self._rounds.append(one)
            diagonal, beside = one.left_of(diagonal[::2])
        self._last = np.asarray(np.linalg.inv(diagonal))
        self.log_determinant += float(np.linalg.slogdet(diagonal)[1].sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for right hand sides (K, n, C)."""
        kept = []
        for one in self._rounds:
            kept.append(right[1::2])
            right = one.forward(right)
        found = self._last @ right
        for one, odd in zip(reversed(self._rounds), reversed(kept), strict=True):
            found = one.backward(found, odd)
        return found

    def products(self, right: FloatArray) -> FloatArray:
        """Return right' A^-1 right of right hand sides (K, n, C), (C, C)."""
        total = np.zeros((right.shape[2], right.shape[2]))
        for one in self._rounds:
            total += _product(one.inverse, right[1::2])
            right = one.forward(right)
        return total + _product(self._last, right)


class _Round:
    """Eliminate every other state, those of odd number.

    `inverse` is that of their blocks (M, n, n); `before` and `after` join them to their neighbours, (M, n, n)
    and (M or M - 1, n, n): the last may have none after it.
    """

    def __init__(self, inverse: FloatArray, before: FloatArray, after: FloatArray) -> None:
        self.inverse = inverse
        self._before, self._after = before, after
        # What a neighbour's value moves the eliminated state by.
        self._by_before, self._by_after = inverse @ before, inverse[: len(after)] @ after

    def left_of(self, even: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the diagonal and what stands beside it without the odd states, from that of even ones."""
        last = len(self._after)
        diagonal = even.copy()
        diagonal[: len(self._before)] -= self._before.transpose(0, 2, 1) @ self._by_before
        diagonal[1 : last + 1] -= self._after.transpose(0, 2, 1) @ self._by_after
        # Rounding must not make them uneven.
        diagonal = 0.5 * (diagonal + diagonal.transpose(0, 2, 1))
        return diagonal, -(self._before[:last].transpose(0, 2, 1) @ self._by_after)

    def forward(self, right: FloatArray) -> FloatArray:
        """Return the right hand sides of the even states."""
        odd, even = right[1::2], right[::2].copy()
        even[: len(odd)] -= self._by_before.transpose(0, 2, 1) @ odd
        even[1 : len(self._after) + 1] -= self._by_after.transpose(0, 2, 1) @ odd[: len(self._after)]
        return even

    def backward(self, even: FloatArray, odd: FloatArray) -> FloatArray:
        """Return all states from the even ones and the odd ones' right hand sides."""
        out = np.empty((len(even) + len(odd), *even.shape[1:]))
        found = self.inverse @ odd - self._by_before @ even[: len(odd)]
        found[: len(self._after)] -= self._by_after @ even[1 : len(self._after) + 1]
        out[::2], out[1::2] = even, found
        return out


def _product(inverse: FloatArray, right: FloatArray) -> FloatArray:
    """Return the sum over states of right' inverse right, of (M, n, n) and (M, n, C): (C, C)."""
    some = right.any(axis=(1, 2))
    inside = right[some]
    width = right.shape[2]
    return np.asarray(inside.reshape(-1, width).T @ (inverse[some] @ inside).reshape(-1, width))
