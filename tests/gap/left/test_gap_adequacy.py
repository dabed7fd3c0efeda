"""Tests of what is left: structure is seen, chance is not."""

from __future__ import annotations

import numpy as np

from mavcompass.gap.left.adequacy import _line, _recurring, _sweep


def test_scatter_that_comes_again_is_seen_in_its_rhythm() -> None:
    rng = np.random.default_rng(9)
    n = 2000
    chance = [_recurring(rng.standard_normal(n), 0.05) for _ in range(200)]
    assert min(chance) > 1e-4 and np.mean(np.array(chance) < 0.1) < 0.16
    on = np.sin(2.0 * np.pi * np.arange(n) * 0.05 / 15.0) > 0.75
    louder = (rng.standard_normal((n, 3)) * np.sqrt(1.0 + 0.5 * on[:, None])) ** 2
    power = louder.mean(axis=1) - louder.mean()
    assert _recurring(power / power.std(), 0.05) < 1e-4


def test_line_that_sweeps_is_seen_where_no_line_stands() -> None:
    rng = np.random.default_rng(10)
    n = 1000
    chance = [_sweep(rng.standard_normal((n, 3))) for _ in range(60)]
    assert min(chance) > 1e-3 and np.mean(np.array(chance) < 0.1) < 0.2
    t = np.arange(n) * 0.05
    for rate in (0.02, 0.15):
        wave = np.sin(2.0 * np.pi * (0.1 + 0.5 * rate * t) * t)[:, None] * np.array([0.5, -0.3, 0.2])
        for swept in (wave, wave[::-1]):
            z = rng.standard_normal((n, 3)) + swept
            assert _sweep(z) < 1e-12
            assert _line(z) > 1e-5
