"""How far a receiver's places wander is read off its own velocities."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.replay.whereabouts import goes_about, place_scatter_m, wander_m
from mavcompass.track import Series

_TIME_S = np.arange(0.0, 300.0, 0.2)


def _receiver(wander_m: float, seed: int = 3, radius_m: float = 10.0) -> tuple[Series, Series]:
    """Drive a circle; let the places wander with a memory of a minute, and the velocities scatter."""
    rng = np.random.default_rng(seed)
    turn = 0.2 * _TIME_S[:, None] + np.array([0.0, 0.5 * np.pi, 0.0])
    place, velocity = radius_m * np.sin(turn), 0.2 * radius_m * np.cos(turn)
    place[:, 2] = velocity[:, 2] = 0.0
    keep, walk = np.exp(-0.2 / 60.0), np.zeros((_TIME_S.size, 3))
    for i in range(1, len(walk)):
        walk[i] = keep * walk[i - 1] + wander_m * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    noise = rng.standard_normal((2, *place.shape))
    return (
        Series.of(_TIME_S, place + walk + 0.02 * noise[0]),
        Series.of(_TIME_S, velocity + 0.02 * noise[1]),
    )


@pytest.mark.parametrize("wander", [0.0, 0.8])
def test_how_far_places_scatter_is_told_beside_their_way_and_wander(wander: float) -> None:
    place, _ = _receiver(wander)
    # What wanders for a minute steps by a few centimetres in a fifth of a second, which is scatter, too.
    assert place_scatter_m(place) == pytest.approx(np.hypot(0.02, 0.8 * wander * 0.05), rel=0.25)
    assert place_scatter_m(None).tolist() == place_scatter_m(place.between(0.0, 5.0)).tolist() == [0.0] * 3


def test_without_velocities_of_its_own_nothing_tells() -> None:
    place, _ = _receiver(0.8)
    assert wander_m(place, None) is None and wander_m(None, None) is None


@pytest.mark.parametrize(
    ("wander", "radius_m", "hears_velocity", "about"),
    [
        # The spread of a circle is its radius over the square root of two.
        (0.0, 1.7, True, True),
        (0.0, 0.5, True, False),  # less than half a metre
        (0.8, 1.7, True, False),  # less than three times how far places wander, or than a metre and a half
        (0.8, 4.0, True, True),
        (0.0, 1.7, False, False),
        (0.0, 4.0, False, True),
    ],
)
def test_a_path_counts_where_it_is_longer_than_its_places_wander(
    wander: float, radius_m: float, hears_velocity: bool, about: bool
) -> None:
    place, velocity = _receiver(wander, radius_m=radius_m)
    track: Any = SimpleNamespace(gps_velocity_mps=velocity if hears_velocity else None)
    reference: Any = SimpleNamespace(kind="fused")
    assert goes_about(place, track, reference) == about
