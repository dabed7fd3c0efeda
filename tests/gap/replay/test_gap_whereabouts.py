"""How far a receiver's places wander is read off its own velocities."""

from __future__ import annotations

import numpy as np

from mavcompass.gap.replay.whereabouts import place_curves
from mavcompass.track import Series

_TIME_S = np.arange(0.0, 300.0, 0.2)


def _receiver(wander_m: float, seed: int = 3) -> tuple[Series, Series]:
    """Drive a circle; let the places wander with a memory of a minute, and the velocities scatter."""
    rng = np.random.default_rng(seed)
    turn = 0.2 * _TIME_S[:, None] + np.array([0.0, 0.5 * np.pi, 0.0])
    place, velocity = 10.0 * np.sin(turn), 2.0 * np.cos(turn)
    place[:, 2] = velocity[:, 2] = 0.0
    keep, walk = np.exp(-0.2 / 60.0), np.zeros((_TIME_S.size, 3))
    for i in range(1, len(walk)):
        walk[i] = keep * walk[i - 1] + wander_m * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    noise = rng.standard_normal((2, *place.shape))
    return (
        Series.of(_TIME_S, place + walk + 0.02 * noise[0]),
        Series.of(_TIME_S, velocity + 0.02 * noise[1]),
    )


def test_the_curves_hold_the_wander_that_there_is() -> None:
    place, velocity = _receiver(0.8)
    curves = place_curves(place, velocity, _TIME_S)
    allowed = np.sqrt(np.mean(np.sum(curves**2, axis=2), axis=0))
    assert ((allowed > 0.4) & (allowed < 1.3)).all()
    # A constant is the datum's, which no curve moves.
    assert np.abs(curves.mean(axis=0)).max() < 1e-9


def test_places_that_agree_with_the_velocities_do_not_wander() -> None:
    place, velocity = _receiver(0.0)
    assert place_curves(place, velocity, _TIME_S).shape == (_TIME_S.size, 3, 0)


def test_without_velocities_of_its_own_nothing_tells() -> None:
    place, _ = _receiver(0.8)
    assert place_curves(place, None, _TIME_S).shape[2] == 0
    assert place_curves(None, None, _TIME_S).shape[2] == 0
