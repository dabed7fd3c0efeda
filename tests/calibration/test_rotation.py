"""Which way a compass is mounted, by what it reads and what it should: equation (O1)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from calibration_worlds import body_field

from mavcompass.calibration.mounting import find_rotation
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, sensor_orientation_matrix

LEVEL = np.linspace(0.0, 6.2, 400)


def tumbling() -> FloatArray:
    rng = np.random.default_rng(4)
    q = rng.normal(size=(1500, 3))
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True) * 480.0)


@pytest.mark.parametrize("number", [0, 2, 4, 8, 12, 16, 25, 38])
@pytest.mark.parametrize("motion", ["level", "tumbling"])
def test_the_rotation_is_found_beside_hard_iron_and_a_gain(number: int, motion: str) -> None:
    field = body_field(LEVEL) if motion == "level" else tumbling()
    turned = sensor_orientation_matrix(number)
    noise = np.random.default_rng(2).normal(0.0, 3.0, field.shape)
    raw = 0.8 * (field + noise) @ turned + (40.0, -20.0, 90.0)
    found = find_rotation(raw, field)
    assert found == pytest.approx(turned, abs=0.03)


def test_a_free_angle_is_found_to_half_a_degree() -> None:
    turned = euler_to_matrix(*np.radians([10.0, -20.0, 33.0]))
    found = find_rotation(tumbling() @ turned, tumbling())
    assert np.degrees(np.linalg.norm(found - turned) / math.sqrt(2.0)) < 0.5


def test_a_short_turn_tells_nothing_and_unknown_rows_are_passed_over() -> None:
    with pytest.raises(PoorCalibration, match="turned too little"):
        find_rotation(body_field(LEVEL[:20]), body_field(LEVEL[:20]))
    expected = tumbling()
    expected[::2] = np.nan
    assert find_rotation(tumbling(), expected) == pytest.approx(np.eye(3), abs=1e-6)
    with pytest.raises(PoorCalibration):
        find_rotation(tumbling(), np.full((1500, 3), np.nan))
