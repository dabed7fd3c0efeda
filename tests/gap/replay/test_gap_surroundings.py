"""Whether a path is longer than the errors of its places."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.replay.surroundings import goes_about
from mavcompass.track import Series


@pytest.mark.parametrize(
    ("kind", "radius_m", "about"),
    # The spread of a circle is its radius over the square root of two.
    [("fused", 1.7, False), ("fused", 4.0, True), ("columns", 0.05, False), ("columns", 0.5, True)],
)
def test_a_path_counts_where_it_is_longer_than_its_places_err(
    kind: str, radius_m: float, about: bool
) -> None:
    turned = np.linspace(0.0, 12.0, 400)
    circle = radius_m * np.stack([np.cos(turned), np.sin(turned), np.zeros(400)], axis=1)
    reference: Any = SimpleNamespace(kind=kind)
    assert goes_about(Series.of(5.0 * turned, circle), reference) == about
    assert not goes_about(None, reference)
