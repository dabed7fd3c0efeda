"""What chance reaches."""

from __future__ import annotations

import numpy as np

from mavcompass.gap.fit.hypothesis import CHANCE, least_gain


def test_chance_of_one_more_effect_is_what_is_said() -> None:
    rng = np.random.default_rng(3)
    gains = rng.chisquare(3, 2_000_000)
    assert np.mean(gains > least_gain(3)) < 2.5 * CHANCE
