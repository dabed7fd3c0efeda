"""One step of Gauss and Newton beside bounds, against bounded least squares; and the doubt that it leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.algebra import cluster_covariance, invert, solve_within


@pytest.mark.parametrize("seed", range(12))
def test_what_meets_a_bound_stays_there_and_the_rest_is_best_beside_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, wanted = rng.standard_normal((40, 6)), 3.0 * rng.standard_normal(40)
    down, up = -rng.uniform(0.05, 2.0, 6), rng.uniform(0.05, 2.0, 6)
    step = solve_within(columns.T @ columns, columns.T @ wanted, 0.0, down, up)
    best = lsq_linear(columns, wanted, (down, up), tol=1e-12)
    assert (step >= down - 1e-9).all() and (step <= up + 1e-9).all()
    cost = 0.5 * float(np.sum((columns @ step - wanted) ** 2))
    # What was once put to its end stays there: near the best, and never worse than cutting the free step.
    cut = np.clip(np.linalg.lstsq(columns, wanted, rcond=None)[0], down, up)
    assert cost <= 1.02 * best.cost and cost <= 0.5 * float(np.sum((columns @ cut - wanted) ** 2)) + 1e-9


def test_inside_its_room_a_step_is_the_free_one() -> None:
    rng = np.random.default_rng(4)
    columns, wanted = rng.standard_normal((30, 4)), rng.standard_normal(30)
    far = np.full(4, 100.0)
    step = solve_within(columns.T @ columns, columns.T @ wanted, 0.0, -far, far)
    assert step == pytest.approx(np.linalg.lstsq(columns, wanted, rcond=None)[0])


def test_covariance_of_a_mean_is_that_of_the_sums_of_its_blocks() -> None:
    residual = np.array([3.0, 1.0, -2.0, 0.0, -1.0, -1.0])
    found = cluster_covariance(np.ones((6, 1)), residual, np.array([7, 7, 2, 2, 5, 5]), np.zeros((1, 1)))
    # Sums 4, -2, -2; three blocks of two.
    assert found == pytest.approx(np.array([[3.0 / 2.0 * 24.0 / 36.0]]))


def test_one_block_says_nothing_of_lasting_errors() -> None:
    columns = np.random.default_rng(1).standard_normal((20, 2))
    found = cluster_covariance(columns, 9.0 * np.ones(20), np.zeros(20, dtype=np.int64), np.eye(2))
    assert found == pytest.approx(invert(columns.T @ columns + np.eye(2)))


@pytest.mark.parametrize("seed", range(6))
def test_covariance_is_never_less_than_that_of_single_readings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, residual = rng.standard_normal((60, 3)), 0.3 * rng.standard_normal(60)
    plain = invert(columns.T @ columns + np.eye(3))
    found = cluster_covariance(columns, residual, np.arange(60) // 10, np.eye(3))
    assert (np.diag(found) >= np.diag(plain) * (1.0 - 1e-12)).all()
    assert np.linalg.eigvalsh(found).min() >= -1e-12


def _covers(lasting: float, block: int) -> tuple[float, float]:
    """Return how often 95 % intervals, plain and of blocks, hold a slope and an offset of noisy readings."""
    rng, plain_hits, hits = np.random.default_rng(20_251), 0, 0
    columns: FloatArray = np.stack([np.ones(600), np.sin(np.arange(600) / 9.0)], axis=1)
    plain = invert(columns.T @ columns)
    for _ in range(400):
        error, white = np.zeros(600), rng.standard_normal(600)
        error[0] = white[0]
        for k in range(1, 600):
            error[k] = lasting * error[k - 1] + np.sqrt(1.0 - lasting**2) * white[k]
        off = plain @ columns.T @ error
        found = cluster_covariance(columns, error - columns @ off, np.arange(600) // block, np.zeros((2, 2)))
        plain_hits += int((np.abs(off) < 1.96 * np.sqrt(np.diag(plain))).sum())
        hits += int((np.abs(off) < 1.96 * np.sqrt(np.diag(found))).sum())
    return plain_hits / 800, hits / 800


def test_intervals_cover_errors_that_last() -> None:
    plain, found = _covers(lasting=0.8, block=30)
    assert plain < 0.65
    assert 0.90 < found < 0.98


def test_intervals_cover_white_errors() -> None:
    plain, found = _covers(lasting=0.0, block=30)
    assert 0.93 < plain <= found < 0.99
