"""Normal equations by block against plain least squares; whitening many columns at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import BlockNormal, invert
from mavcompass.gap.replay.noise import SensorNoise, estimate_noise

ROWS, BLOCKS = 600, 20
BLOCK = np.repeat(np.arange(BLOCKS), ROWS // BLOCKS)


class Plain:
    """Solve the same problem with the priors as rows under the columns."""

    def __init__(self, seed: int, nuisances: int, others: int) -> None:
        rng = np.random.default_rng(seed)
        total = nuisances + others
        mixed = rng.standard_normal((total, total)) * 0.4 + np.eye(total)
        self.columns = rng.standard_normal((ROWS, total)) @ mixed * 10.0 ** rng.uniform(-2.0, 2.0, total)
        self.residual = self.columns @ (rng.standard_normal(total) / np.abs(self.columns).max(axis=0))
        self.residual = self.residual + rng.standard_normal(ROWS)
        root = rng.standard_normal((nuisances, nuisances)) + 2.0 * np.eye(nuisances)
        self.root = root * np.abs(self.columns[:, :nuisances]).mean(axis=0)
        self.offset = rng.standard_normal(nuisances) / np.abs(self.columns[:, :nuisances]).max(axis=0)
        self.usual = 10.0 ** rng.uniform(0.0, 2.0, others) / np.abs(self.columns[:, nuisances:]).max(axis=0)
        self.nuisances = nuisances

    def solve(self, own: list[int]) -> tuple[float, FloatArray]:
        """Return the least sum of squares with some of the other columns, and the values."""
        n = self.nuisances
        J = self.columns[:, [*range(n), *(n + i for i in own)]]
        prior = np.zeros((n, J.shape[1]))
        prior[:, :n] = self.root
        usual = np.zeros((len(own), J.shape[1]))
        usual[:, n:] = np.diag(1.0 / self.usual[own])
        A = np.vstack([J, prior, usual])
        b = np.concatenate([self.residual, self.root @ self.offset, np.zeros(len(own))])
        x = np.linalg.lstsq(A, b, rcond=None)[0]
        return float(np.sum((b - A @ x) ** 2)), x

    def blocks(self) -> BlockNormal:
        precision = self.root.T @ self.root
        loose = np.zeros(self.nuisances, dtype=np.bool_)
        return BlockNormal(
            self.columns, self.residual, BLOCK, self.nuisances, precision, self.offset, self.usual, loose
        )


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.integers(0, 4), st.integers(1, 5), st.data())
def test_gain_and_values_are_those_of_plain_least_squares(
    seed: int, nuisances: int, others: int, data: st.DataObject
) -> None:
    plain = Plain(seed, nuisances, others)
    own = data.draw(st.lists(st.integers(0, others - 1), unique=True, max_size=others))
    normal = plain.blocks()
    index = np.array(own, dtype=np.int64)
    alone, _ = plain.solve([])
    best, values = plain.solve(own)
    everything = np.arange(others)
    gains = normal.gains([index, everything, index[:0], everything[::-1]])
    assert gains[0] == pytest.approx(alone - best, rel=1e-5, abs=1e-5)
    assert gains[1] == pytest.approx(alone - plain.solve(list(range(others)))[0], rel=1e-5, abs=1e-5)
    assert gains[2] == 0.0 and gains[3] == pytest.approx(gains[1], rel=1e-6, abs=1e-9)
    found = normal.solve(index)
    assert found.gain == pytest.approx(gains[0], rel=1e-9, abs=1e-9)
    size = normal.size
    got = np.concatenate([found.nuisances * size[:nuisances], found.values * size[nuisances + index]])
    want = values * np.concatenate([size[:nuisances], size[nuisances + index]])
    np.testing.assert_allclose(got, want, atol=1e-4)
    constant = float(plain.residual @ plain.residual + np.sum((plain.root @ plain.offset) ** 2))
    assert constant - normal.null_gain == pytest.approx(alone, rel=1e-6)


def contradictions(lasting: float) -> FloatArray:
    """Return what blocks contradict each other by about slow columns, in errors that partly last a block."""
    out = []
    for seed in range(60):
        rng = np.random.default_rng([seed, 5])
        t = np.arange(ROWS) / ROWS
        phases = rng.uniform(0.0, 6.0, 4)
        J = np.sin(2.0 * np.pi * t[:, None] * np.array([1.0, 2.0, 3.0, 5.0]) + phases)
        error = rng.standard_normal(ROWS) + lasting * rng.standard_normal(BLOCKS)[BLOCK]
        normal = BlockNormal(
            J, J @ [0.5, 1.0, -1.0, 2.0] + error, BLOCK, 1, np.eye(1), np.zeros(1), np.full(3, 1e3),
            np.ones(1, dtype=np.bool_),
        )  # fmt: skip
        out.append(normal.overdispersion_of(np.arange(3), np.array([1, 2])))
    return np.array(out)


def test_blocks_contradict_each_other_only_where_errors_last() -> None:
    honest, lasting = contradictions(0.0), contradictions(1.0)
    assert (honest >= 1.0).all() and honest.mean() < 1.3 and np.median(honest) < 1.2
    # Thirty rows with a common error of the size of the scatter: up to 1 + 30.
    assert 8.0 < lasting.mean() < 31.0 and np.quantile(lasting, 0.02) > 3.0


def noise_of(moving: tuple[float, float, float], lags: int, extras: bool) -> SensorNoise:
    rng = np.random.default_rng(7)
    coefficients = np.array([[0.9, 0.8, 0.95], [0.05, -0.1, 0.02]])[:lags].reshape(lags, 3)
    sigma = np.array([1.0, 2.0, 3.0])
    turned = np.linalg.qr(rng.standard_normal((200, 3, 3)))[0]
    return SensorNoise(
        coefficients,
        sigma,
        1.5 * sigma,
        200.0,
        row_scale=rng.uniform(1.0, 2.0, (200, 3)) if extras else None,
        moving=np.array(moving),
        channels=turned if extras else None,
    )


@pytest.mark.parametrize("extras", [False, True])
@pytest.mark.parametrize(
    ("moving", "lags"),
    [((0.0, 0.0, 0.0), 0), ((0.0, 0.0, 0.0), 2), ((0.6, 0.6, 0.6), 1), ((0.3, 0.6, 0.8), 1)],
)
def test_many_columns_are_whitened_as_each_alone(
    moving: tuple[float, float, float], lags: int, extras: bool
) -> None:
    noise = noise_of(moving, lags, extras)
    errors = np.random.default_rng(8).standard_normal((200, 3, 5))
    many = noise.whiten_many(errors)
    for k in range(5):
        np.testing.assert_allclose(many[:, :, k], noise.whiten(errors[:, :, k]), atol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_channels_of_mixed_kinds_are_whitened_alike(first: int) -> None:
    noise = noise_of((0.0, 0.6, 0.8), 1, True)
    errors = np.random.default_rng(9).standard_normal((200, 3, 2))
    many = noise.whiten_many(errors)
    for k in range(2):
        np.testing.assert_allclose(many[first:, :, k], noise.whiten(errors[:, :, k])[first:], atol=1e-12)


@pytest.mark.parametrize(("moving", "lags"), [((0.0, 0.0, 0.0), 1), ((0.3, 0.6, 0.8), 1)])
def test_after_a_silence_a_reading_tells_its_level_anew(
    moving: tuple[float, float, float], lags: int
) -> None:
    noise = noise_of(moving, lags, False)
    errors = np.random.default_rng(11).standard_normal((60, 3, 2))
    begins = replace(noise, begins=np.array([25, 40])).whiten_many(errors)
    for at, piece in zip((0, 25, 40), np.split(errors, [25, 40]), strict=True):
        alone = noise.whiten_many(piece)
        np.testing.assert_allclose(begins[at + 1 : at + len(piece)], alone[1:], atol=1e-12)
        if at:
            np.testing.assert_allclose(begins[at], errors[at] / noise.rms[:, None])


def test_each_channel_gets_its_own_noise() -> None:
    rng = np.random.default_rng(10)
    n = 4000
    rotation = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    values = rng.standard_normal((n, 3)) * [1.0, 2.0, 4.0]
    for i in range(1, n):
        values[i, 2] += 0.6 * values[i - 1, 2]
    error = np.einsum("nji,nj->ni", rotation, values)
    noise = estimate_noise(error, np.ones(n, dtype=np.bool_), 0.0, rotation)
    np.testing.assert_allclose(noise.sigma, [1.0, 2.0, 4.0], rtol=0.05)
    np.testing.assert_allclose(noise.in_channels(error), values, atol=1e-9)
    z = noise.whiten(error)[4:]
    np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.05)
    assert np.abs(np.mean(z[1:] * z[:-1], axis=0)).max() < 0.06


def test_covariance_of_what_nothing_tells_is_none() -> None:
    normal = np.diag([4.0, 0.0, 1e-12])
    assert invert(normal) == pytest.approx(np.diag([0.25, 0.0, 1e12]))
