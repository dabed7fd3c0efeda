"""One step of Gauss and Newton beside bounds, against bounded least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from mavcompass.gap.fit.newton import room, solve_within


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


def test_room_is_told_of_free_parameters_alone() -> None:
    x = [np.array([1.0, 2.0]), np.array([0.0])]
    free = [np.array([1]), np.array([0])]
    bounds = [(np.array([-9.0, 0.5]), np.array([9.0, 5.0])), (np.array([-1.0]), np.array([0.0]))]
    down, up = room(x, free, bounds)
    assert down.tolist() == [-1.5, -1.0] and up.tolist() == [3.0, 0.0]
