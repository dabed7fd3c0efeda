"""The field where a recording was made: the model's, what other compasses say, or its own; and its path."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.earth_field import earth_field
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.gap.replay.surroundings import goes_about, world_field
from mavcompass.gap.tables import usual
from mavcompass.track import MagSeries, Series, Track

N = 600
TIME = np.arange(N) * 0.1
PLACE = (47.4, 8.5, 500.0)
MODEL = earth_field(*PLACE, 2026.5)
ROTATION = euler_to_matrix(np.zeros(N), np.zeros(N), 0.3 * TIME)
Offsets = tuple[float, float]


def measured(level: float, down: float, scatter: float = 0.0) -> FloatArray:
    """What a turning compass reads in a field so much stronger than the model's, (N, 3)."""
    north, east, z = MODEL.vector_mgauss
    factor = 1.0 + level / math.hypot(north, east)
    swing = scatter * np.where(np.arange(N) % 2 == 0, 1.0, -1.0)
    world = np.stack([factor * north + swing, np.full(N, factor * east), np.full(N, z + down)], axis=1)
    return rotate_back(ROTATION, world)


def recording(*others: FloatArray, known: bool = True, place: bool = True, count: int = N) -> Track:
    compasses = {1: MagSeries(1, Series.of(TIME, measured(0.0, 0.0)))}
    for number, values in enumerate(others, start=2):
        series = Series.of(TIME[:count], values[:count])
        compasses[number] = MagSeries(number, series, correction_known=known)
    where = Series.of(TIME, np.tile(PLACE, (N, 1)) if place else np.full((N, 3), np.nan))
    return Track(source="made up", compasses=compasses, place=where)


def reference(kind: str = "estimator", known: int = N) -> Any:
    return SimpleNamespace(kind=kind, rotation=ROTATION, known=np.arange(N) < known)


def found(
    track: Track, raw: FloatArray | None = None, **more: Any
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    return world_field(track, 1, TIME, reference(**more), measured(0.0, 0.0) if raw is None else raw)


@pytest.mark.parametrize(("kind", "anomaly"), [("estimator", 0.01), ("columns", 0.0)])
def test_the_models_field_is_known_to_one_percent_but_in_a_laboratory(kind: str, anomaly: float) -> None:
    field, sigma, notes = found(recording(), kind=kind)
    np.testing.assert_allclose(field, MODEL.vector_mgauss, atol=0.2)
    wanted = np.hypot(MODEL.sigma_mgauss, anomaly * np.linalg.norm(field))
    np.testing.assert_allclose(sigma, wanted, rtol=1e-3)
    assert notes == ()


def test_two_others_that_agree_give_the_field_but_not_its_direction() -> None:
    field, sigma, (note,) = found(recording(measured(3.0, -4.0), measured(3.6, -4.6)))
    level = math.hypot(*MODEL.vector_mgauss[:2])
    assert math.hypot(field[0], field[1]) - level == pytest.approx(3.3, abs=0.2)
    assert field[2] - MODEL.vector_mgauss[2] == pytest.approx(-4.3, abs=0.2)
    assert math.atan2(field[1], field[0]) == pytest.approx(MODEL.declination_rad, abs=1e-4)
    assert sigma[0] == sigma[2] == 0.7 and "other compasses agree" in note


@pytest.mark.parametrize(
    ("others", "more"),
    [
        ([(3.0, 0.0)], {}),  # one alone is no witness
        ([(3.0, 0.0), (4.6, 0.0)], {}),  # they differ by more than 1.4 mG
        ([(3.0, 0.0), (3.0, 1.6)], {}),
        ([(8.2, 0.0), (8.2, 0.0)], {}),  # the same iron beside both
        ([(0.0, -8.2), (0.0, -8.2)], {}),
        ([(3.0, 0.0), (3.0, 0.0)], {"known": False}),
        ([(3.0, 0.0), (3.0, 0.0)], {"count": 20}),
    ],
)
def test_others_that_are_no_witnesses_leave_the_models_field(
    others: list[Offsets], more: dict[str, Any]
) -> None:
    field, _, notes = found(recording(*(measured(*offsets) for offsets in others), **more))
    np.testing.assert_allclose(field, MODEL.vector_mgauss, atol=0.2)
    assert notes == ()


@pytest.mark.parametrize(("scatter", "counts"), [(1.9, True), (2.2, False)])
def test_a_witness_sees_a_constant_field(scatter: float, counts: bool) -> None:
    """Scatter of 1.48 median deviations, below 3 mG."""
    noisy = measured(3.0, 0.0, scatter)
    assert bool(found(recording(noisy, noisy))[2]) is counts


def test_without_a_place_the_field_is_its_own_median_in_the_world() -> None:
    own = measured(20.0, -30.0)
    own[::7] += 500.0
    field, sigma, (note,) = found(recording(place=False), own)
    north, east, z = MODEL.vector_mgauss
    assert math.hypot(field[0], field[1]) == pytest.approx(math.hypot(north, east) + 20.0, abs=2.0)
    assert field[2] == pytest.approx(z - 30.0, abs=2.0)
    assert sigma.tolist() == [usual.place.unknown_mgauss] * 3 and "cannot be judged" in note
    with pytest.raises(BadRecording, match="never speak at the same time"):
        found(recording(place=False), own, known=0)


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
