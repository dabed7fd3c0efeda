"""Where a fit of a magnet at one place begins: near enough to the magnet, wherever the path leads."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.simulation.effects.causes.world import _dipoles, _polished, dipole_field


@pytest.mark.parametrize("seed", range(20))
def test_climbing_takes_away_nearly_all_that_the_magnet_itself_would(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 100.0, 400)
    around = [10.0 * np.sin(time / 9.0 + rng.uniform(0.0, 6.0)), 8.0 * np.sin(time / 7.0)]
    path = np.stack([*around, -1.0 - rng.uniform() * np.sin(time / 20.0)], axis=1)
    source = path[rng.integers(400)] + rng.normal(0.0, 1.5, 3)
    field = dipole_field(path, source, rng.normal(0.0, 200.0, 3)) + rng.normal(0.0, 2.0, (400, 3))
    peak = path[np.argsort(-np.linalg.norm(field, axis=1))[:40]].mean(axis=0)
    found = _polished(path, field, peak + rng.normal(0.0, 0.5, (3, 3)), 2.0)
    (best,), _ = _dipoles(path, field, source[None])
    assert _dipoles(path, field, found)[0].max() > 0.97 * best
