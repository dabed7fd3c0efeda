"""The chain's banded solution against dense least squares over the same equations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.chain import Chain

SEEDS = range(8)


@dataclass
class Dense:
    """Collect the same equations as rows of one dense matrix over all states and constants."""

    length: int
    width: int
    constants: int
    rows: list[FloatArray] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)

    def put(self, parts: dict[int, FloatArray], c: FloatArray | None, y: float, w: float) -> None:
        if w == 0.0:
            return
        row = np.zeros(self.length * self.width + self.constants)
        for k, J in parts.items():
            row[k * self.width : (k + 1) * self.width] = J
        if c is not None:
            row[self.length * self.width :] = c
        self.rows.append(row)
        self.values.append(y)
        self.sigmas.append(w**-0.5)

    @property
    def whitened(self) -> tuple[FloatArray, FloatArray]:
        sigma = np.array(self.sigmas)
        return np.array(self.rows) / sigma[:, None], np.array(self.values) / sigma

    def solution(self) -> FloatArray:
        return np.asarray(np.linalg.lstsq(*self.whitened, rcond=None)[0])

    def covariance(self) -> FloatArray:
        J, _ = self.whitened
        return np.asarray(np.linalg.inv(J.T @ J))

    def deviance(self) -> float:
        """Return -2 log of the integral of all equations' normal densities over the unknowns."""
        J, y = self.whitened
        left = y - J @ self.solution()
        densities = float(left @ left) + sum(math.log(2.0 * math.pi * s**2) for s in self.sigmas)
        integral = J.shape[1] * math.log(2.0 * math.pi) - float(np.linalg.slogdet(J.T @ J)[1])
        return densities - integral


class Both:
    """Add the same random equations to a chain and to the dense matrix."""

    def __init__(self, length: int, width: int, constants: int) -> None:
        self.chain, self.dense = Chain(length, width, constants), Dense(length, width, constants)
        self.shape = length, width, constants

    def add(self, rng: np.random.Generator, at: slice, rows: int, with_constants: bool) -> None:
        length, width, constants = self.shape
        which = range(*at.indices(length))
        n = len(which)
        J, y, w = drawn(rng, n, rows, width), rng.normal(size=(n, rows)), weights(rng, n, rows)
        c = drawn(rng, n, rows, constants) if with_constants else None
        self.chain.add(at, J, c, y, w)
        for i, k in enumerate(which):
            for r in range(rows):
                self.dense.put({k: J[i, r]}, None if c is None else c[i, r], y[i, r], w[i, r])

    def link(self, rng: np.random.Generator, rows: int, with_constants: bool) -> None:
        length, width, constants = self.shape
        n = length - 1
        before, after = drawn(rng, n, rows, width), drawn(rng, n, rows, width)
        y, w = rng.normal(size=(n, rows)), weights(rng, n, rows)
        c = drawn(rng, n, rows, constants) if with_constants else None
        self.chain.link(before, after, c, y, w)
        for k in range(n):
            for r in range(rows):
                parts = {k: before[k, r], k + 1: after[k, r]}
                self.dense.put(parts, None if c is None else c[k, r], y[k, r], w[k, r])

    def know(self, mean: FloatArray, sigma: FloatArray) -> None:
        self.chain.know(mean, sigma)
        for i, unit in enumerate(np.eye(self.shape[2])):
            self.dense.put({}, unit, mean[i], sigma[i] ** -2.0)


def drawn(rng: np.random.Generator, *shape: int) -> FloatArray:
    return np.asarray(rng.normal(size=shape))


def weights(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Draw weights over two decades; some equations have none."""
    return np.where(rng.random(shape) < 0.1, 0.0, 10.0 ** rng.uniform(-1.0, 1.0, shape))


def some_chain(seed: int) -> Both:
    """Draw a chain: every state is seen, the links and some of the sightings depend on the constants."""
    rng = np.random.default_rng([seed, 77])
    length, width, constants = (int(rng.integers(a, b)) for a, b in ((3, 9), (1, 5), (1, 4)))
    both = Both(length, width, constants)
    both.add(rng, slice(None), width + 1, True)
    both.add(rng, slice(1), width, False)
    both.add(rng, slice(1, length - 1), 1, True)
    both.link(rng, width, True)
    both.link(rng, 2, False)
    both.know(rng.normal(size=constants), rng.uniform(0.2, 2.0, constants))
    return both


@pytest.mark.parametrize("seed", SEEDS)
def test_states_and_constants_are_those_of_dense_least_squares(seed: int) -> None:
    both = some_chain(seed)
    solved = both.chain.solve()
    found = np.concatenate([solved.states.ravel(), solved.constants])
    np.testing.assert_allclose(found, both.dense.solution(), atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_covariance_of_some_states_is_a_block_of_the_dense_inverse(seed: int) -> None:
    both = some_chain(seed)
    length, width, _ = both.shape
    dense = both.dense.covariance()
    solved = both.chain.solve()
    for which in (np.array([0]), np.array([0, length - 1]), np.arange(length)):
        for count in {1, width}:
            rows = (which[:, None] * width + np.arange(count)).ravel()
            each = np.eye(rows.size).reshape(which.size, count, -1)
            found = solved.covariance_with(which, each)[which, :count].reshape(rows.size, -1)
            np.testing.assert_allclose(found, dense[np.ix_(rows, rows)], rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_covariance_with_sums_of_some_states_is_that_of_the_dense_inverse(seed: int) -> None:
    both = some_chain(seed)
    length, width, _ = both.shape
    dense, solved = both.dense.covariance(), both.chain.solve()
    which, count = np.array([0, length - 1]), max(width - 1, 1)
    sums = np.random.default_rng(seed).normal(size=(which.size, count, 3))
    rows = (which[:, None] * width + np.arange(count)).ravel()
    wanted = dense[: length * width, rows] @ sums.reshape(rows.size, 3)
    found = solved.covariance_with(which, sums)
    np.testing.assert_allclose(found, wanted.reshape(length, width, 3), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_deviance_differs_between_equations_as_the_dense_likelihood_does(seed: int) -> None:
    # Other values and other weights of as many equations: what remains is one constant for all.
    apart = []
    for draw in range(4):
        rng = np.random.default_rng([seed, 78])
        length, width, constants = (int(rng.integers(a, b)) for a, b in ((3, 9), (1, 5), (1, 4)))
        other = np.random.default_rng([seed, draw, 79])
        both = Both(length, width, constants)
        both.add(other, slice(None), width + 1, True)
        both.link(other, width, True)
        both.know(other.normal(size=constants), other.uniform(0.2, 2.0, constants))
        equations = len(both.dense.values)
        apart.append(
            both.chain.solve().deviance
            - both.dense.deviance()
            + (equations - length * width - constants) * math.log(2.0 * math.pi)
        )
    np.testing.assert_allclose(apart, 0.0, atol=1e-7)


def test_likelier_size_of_a_random_walk_has_the_smaller_deviance() -> None:
    rng = np.random.default_rng(5)
    true = 0.3
    path = np.cumsum(rng.normal(0.0, true, 400))
    seen = path + rng.normal(0.0, 0.2, path.size)

    def deviance(step: float) -> float:
        chain = Chain(path.size, 1, 1)
        one, none = np.ones((path.size - 1, 1, 1)), np.zeros((path.size - 1, 1))
        chain.link(-one, one, None, none, none + step**-2.0)
        chain.add(slice(None), np.ones((path.size, 1, 1)), None, seen[:, None], np.full((path.size, 1), 25.0))
        chain.know(np.zeros(1), np.ones(1))
        return chain.solve().deviance

    assert deviance(true) < min(deviance(0.5 * true), deviance(2.0 * true))


def test_what_is_added_to_a_copy_does_not_change_the_chain() -> None:
    both = some_chain(3)
    before = both.chain.solve()
    rng = np.random.default_rng(6)
    length, width, constants = both.shape
    more = both.chain.copy()
    more.add(
        slice(None),
        drawn(rng, length, 2, width),
        drawn(rng, length, 2, constants),
        drawn(rng, length, 2),
        np.ones((length, 2)),
    )
    more.know(np.ones(constants), np.ones(constants))
    after = both.chain.solve()
    np.testing.assert_array_equal(after.states, before.states)
    assert after.deviance == before.deviance
    assert np.abs(more.solve().states - before.states).max() > 1e-3
