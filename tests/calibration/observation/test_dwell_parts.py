"""The parts of a dwell's mean: its memory from reading to reading, its trend with the heading, its halves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import dwells
from mavcompass.frames import FloatArray

FIELD = np.array([200.0, -50.0, 400.0])


def wave(lag_one: float, n: int = 400) -> FloatArray:
    """Readings that resemble the next by so much, on one axis of three."""
    x = np.cos(math.acos(lag_one) * np.arange(n))
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


@pytest.mark.parametrize(
    ("residual", "raised"),
    [
        (wave(0.05), 1.0),  # below two sigmas of three axes' vote, 0.058
        (wave(0.065), 1.065 / 0.935),
        (wave(0.5), 3.0),
        (wave(-0.5), 1.0),
        (wave(0.98), 19.0),  # no more than of 0.9
        (wave(0.5)[:7], 1.0),  # too few to tell
        (np.zeros((50, 3)), 1.0),
    ],
)
def test_what_one_reading_tells_of_the_next_raises_the_variance(residual: FloatArray, raised: float) -> None:
    assert dwells._memory(residual) == pytest.approx(raised, rel=0.02)


@pytest.mark.parametrize(("sway_deg", "follows"), [(0.19, False), (0.21, True), (3.0, True)])
def test_the_field_follows_a_heading_that_sways_by_more_than_a_fifth_of_a_degree(
    sway_deg: float, follows: bool
) -> None:
    angles = 7.0 + math.radians(sway_deg) * np.where(np.arange(40) % 2 == 0, 1.0, -1.0)
    slope = np.array([30.0, -20.0, 0.0])
    field = FIELD + (angles - 7.0)[:, np.newaxis] * slope
    field[3] += 90.0  # of a reading that is not kept
    keep = np.arange(40) != 3
    trend = dwells._trend_from(angles, field, keep)
    assert trend.shape == field.shape
    if follows:
        np.testing.assert_allclose(trend[keep], field[keep], atol=1e-9)
        np.testing.assert_allclose(trend[3], FIELD + (angles[3] - 7.0) * slope, atol=1e-9)
    else:
        np.testing.assert_allclose(trend, np.broadcast_to(np.median(field[keep], axis=0), field.shape))


@pytest.mark.parametrize(
    ("step_mgauss", "leaning_rad", "wanders_mgauss"),
    [
        (4.1, 0.0, 0.0),  # chance: 4 x 2 mG x sqrt(4 / 100) = 1.6 mG, and the step of the numbers, 2.5
        (4.2, 0.0, 4.2),
        (10.0, 0.01, 6.0),  # 400 mG that lean by 0.01 are 4 mG
        (7.0, 0.01, 0.0),
    ],
)
def test_halves_that_lie_apart_beyond_chance_and_tilting_are_told(
    step_mgauss: float, leaning_rad: float, wanders_mgauss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    time = np.arange(100) * 0.1
    asked: list[FloatArray] = []

    def down(track: Any, at: FloatArray) -> FloatArray:
        asked.append(at)
        lean = np.where(np.arange(at.size) < at.size // 2, 0.0, leaning_rad)
        return np.stack([lean, 0.0 * lean, np.ones_like(lean)], axis=1)

    monkeypatch.setattr(dwells, "down_in_body", down)
    monkeypatch.setattr(dwells, "field_lag_s", lambda track: 0.25)
    residual = np.where(time < 4.95, -0.5, 0.5)[:, np.newaxis] * np.array([0.6, 0.0, 0.8]) * step_mgauss
    found = dwells._wander(None, time, residual, 400.0, 2.0, 2.5)  # type: ignore[arg-type]
    assert found == pytest.approx(wanders_mgauss)
    np.testing.assert_allclose(asked[0], time - 0.25)  # the field is old by the autopilot's averaging
    assert dwells._wander(None, time[:3], residual[:3], 400.0, 2.0, 2.5) == 0.0  # type: ignore[arg-type]
