"""A reading that is repeated is late by what the vehicle turned meanwhile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.heading.doubt import turned_since_new, turned_vector
from mavcompass.heading.evidence import heading_of_track
from mavcompass.track import MagSeries, Series, Track

TIME = np.arange(600.0) * 0.1
LEVEL = (0.0, 0.0, -9.80665)


def turned_and_frozen_from(frozen_s: float) -> Track:
    """Stand for 30 s, turn by 90 deg in 10 s and stand again; from a time on the compass repeats itself."""
    rate = np.where((TIME >= 30.0) & (TIME < 40.0), math.radians(9.0), 0.0)
    yaw = np.concatenate([[0.0], np.cumsum(rate[:-1] * 0.1)])
    field = np.stack([230.0 * np.cos(yaw), -230.0 * np.sin(yaw), np.full(600, 520.0)], axis=1)
    field += np.random.default_rng(1).normal(0.0, 1.0, (600, 3))
    field[frozen_s <= TIME] = field[int(frozen_s * 10.0)]
    return Track(
        compasses={1: MagSeries(1, Series.of(TIME, field))},
        gyro_radps=Series.of(TIME, np.stack([np.zeros(600), np.zeros(600), rate], axis=1)),
        acc_mps2=Series.of(TIME, np.tile(LEVEL, (600, 1))),
    )


@pytest.mark.parametrize(("frozen_s", "degrees"), [(20.0, 90.0), (35.0, 45.0), (45.0, 0.0)])
def test_a_frozen_compass_is_late_by_the_turn(frozen_s: float, degrees: float) -> None:
    late = turned_since_new(turned_and_frozen_from(frozen_s), 1)
    assert np.degrees(late[-1]) == pytest.approx(degrees, abs=1.5)
    assert np.degrees(late[TIME < frozen_s]).max() < 1e-6


def test_what_turns_more_than_it_stands_stands_all_the_same() -> None:
    # A quiet compass repeats itself where it stands: that is no turn against the usual one.
    stands = (TIME % 20.0) < 8.0
    rate = np.where(stands, 0.0, math.radians(24.0))
    yaw = np.concatenate([[0.0], np.cumsum(rate[:-1] * 0.1)])
    field = np.round(np.stack([230.0 * np.cos(yaw), -230.0 * np.sin(yaw), np.full(600, 520.0)], axis=1))
    gyro = Series.of(TIME, np.stack([np.zeros(600), np.zeros(600), rate], axis=1))
    track = Track(compasses={1: MagSeries(1, Series.of(TIME, field))}, gyro_radps=gyro)
    assert np.degrees(turned_since_new(track, 1)).max() < 3.0
    frozen = Series.of(TIME, np.tile(field[:1], (600, 1)))
    track = Track(compasses={1: MagSeries(1, frozen)}, gyro_radps=gyro)
    assert np.degrees(turned_since_new(track, 1)).max() > 90.0


def test_the_heading_is_as_unsure_as_its_reading_is_late() -> None:
    before, after = (heading_of_track(turned_and_frozen_from(s)).sigma_rad[-1] for s in (59.8, 20.0))
    assert after == pytest.approx(math.hypot(before, math.radians(90.0)), rel=0.1)


@pytest.mark.parametrize(("deg_s", "turned"), [(3.1, True), (2.9, False), (-20.0, True)])
def test_a_turn_is_what_no_bias_makes(deg_s: float, turned: bool) -> None:
    rates = np.tile([0.0, 0.0, math.radians(deg_s)], (600, 1))
    track = Track(gyro_radps=Series.of(TIME, rates))
    assert bool(np.abs(turned_vector(track, TIME)).max() > 0.5) is turned
    assert not turned_vector(track, TIME, usual=False).any()
    assert not turned_vector(Track(), TIME).any()
