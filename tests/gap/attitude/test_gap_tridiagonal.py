"""Odd-even reduction against the dense matrix, and against scipy's banded solver where that is too large."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.chain import Reduced


def drawn(length: int, width: int, seed: int = 4) -> tuple[FloatArray, FloatArray]:
    """Draw a positive definite matrix: its blocks on the diagonal, and those right of them.

    It is that of equations with weights over six decades: a gyro knows what a magnetometer does not.
    """
    rng = np.random.default_rng([seed, length, width])
    own = rng.normal(size=(length, 2 * width, width))
    before, after = rng.normal(size=(2, length - 1, width, width))
    weights = 10.0 ** rng.uniform(-3.0, 3.0, (length, 2 * width, 1))
    diagonal = own.transpose(0, 2, 1) @ (weights * own)
    diagonal[:-1] += before.transpose(0, 2, 1) @ before
    diagonal[1:] += after.transpose(0, 2, 1) @ after
    return diagonal, before.transpose(0, 2, 1) @ after


def dense(diagonal: FloatArray, beside: FloatArray) -> FloatArray:
    length, width, _ = diagonal.shape
    out = np.zeros((length, width, length, width))
    for k in range(length):
        out[k, :, k] = diagonal[k]
    for k in range(length - 1):
        out[k, :, k + 1] = beside[k]
        out[k + 1, :, k] = beside[k].T
    return out.reshape(length * width, length * width)


@pytest.mark.parametrize("width", [1, 2, 5])
@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 7, 8, 9, 16, 17, 31])
def test_solution_and_determinant_are_those_of_the_dense_matrix(length: int, width: int) -> None:
    diagonal, beside = drawn(length, width)
    matrix, reduced = dense(diagonal, beside), Reduced(diagonal, beside)
    right = np.random.default_rng(5).normal(size=(length, width, 3))
    wanted = np.linalg.solve(matrix, right.reshape(length * width, 3))
    np.testing.assert_allclose(reduced.solve(right).reshape(wanted.shape), wanted, rtol=1e-6, atol=1e-9)
    assert reduced.log_determinant == pytest.approx(np.linalg.slogdet(matrix)[1])


def test_a_long_chain_is_solved_as_exactly_as_by_a_banded_factor() -> None:
    length, width = 700, 13
    diagonal, beside = drawn(length, width)
    band = np.zeros((2 * width, length * width))
    for i in range(width):
        for j in range(i + 1):
            band[i - j, j::width] = diagonal[:, i, j]
        for j in range(width):
            band[width + i - j, j : (length - 1) * width : width] = beside[:, j, i]
    right = np.random.default_rng(6).normal(size=(length, width, 2))
    wanted = scipy.linalg.solveh_banded(band, right.reshape(-1, 2), lower=True)
    found = Reduced(diagonal, beside).solve(right).reshape(-1, 2)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)
    assert Reduced(diagonal, beside).solve(np.zeros((length, width, 1))).any() == np.False_
