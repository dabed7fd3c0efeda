"""Shapes that the catalogue does not hold are never given a sure name."""

from __future__ import annotations

import pytest
from strange_shapes import FLAGGED, verdict_on

from mavcompass.gap.trial.cases import Recipe


@pytest.mark.parametrize("name", ["chirp", "heading wave"])  # the others: strange_shapes.py
def test_shape_outside_the_catalogue_is_flagged(name: str) -> None:
    assert verdict_on(name, Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=71), 90.0, 71) in FLAGGED
