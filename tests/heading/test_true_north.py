"""By how much true north is ahead of magnetic: closed forms, what must not matter, what others recorded."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.api import read_track
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.heading.evidence import heading_of_track
from mavcompass.heading.true_north import ANTENNA_RAD, MOUNTED_RAD, NorthSeen, TrueNorth, north_seen

WORLD = EarthField((200.0, 30.0, 400.0))
DEG = math.pi / 180.0
TIME = np.arange(720.0)
# Legs of half a minute, each on another heading, twice round.
ROUND = np.repeat(np.arange(24) * (2.0 * math.pi / 12.0), 30)
NOWHERE = np.full((TIME.size, 2), np.nan)


def by_course(
    magnetic: FloatArray, true: FloatArray, speed: FloatArray | float, kind: str = "rover"
) -> NorthSeen:
    velocity = np.stack([speed * np.cos(true), speed * np.sin(true)], axis=1)
    (seen,) = north_seen(kind, TIME, magnetic, velocity, NOWHERE[:, 0])
    return seen


@settings(max_examples=25)
@given(st.floats(-3.1, 3.1), st.floats(0.0, 6.2))
def test_it_is_the_angle_between_both_wherever_it_began(turn: float, first: float) -> None:
    seen = by_course(ROUND + first, ROUND + first + turn, 4.0)
    assert float(wrap_pi(seen.turn_rad - turn)) == pytest.approx(0.0, abs=1e-6)
    assert seen.told and seen.chance_rad < 0.1 * DEG and seen.seconds > 600.0


@settings(max_examples=25)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.1, 0.1))
def test_a_deviation_and_a_steady_current_average_out_all_round(
    b: float, c: float, e: float, current: float
) -> None:
    magnetic = ROUND + b * np.sin(ROUND) + c * np.cos(ROUND) + e * np.sin(2.0 * ROUND)
    over_ground = 4.0 * np.exp(1j * (ROUND + 0.2)) + current
    seen = by_course(magnetic, np.angle(over_ground), np.abs(over_ground), "boat")
    # They bend each other: what is left is of second order.
    second = (abs(b) + abs(c) + abs(e) + abs(current) / 4.0) ** 2
    assert float(wrap_pi(seen.turn_rad - 0.2)) == pytest.approx(0.0, abs=0.05 * DEG + second)
    assert seen.told


@pytest.mark.parametrize("minutes", [1.0, 12.0])
def test_at_one_heading_a_deviation_does_not_pass_as_declination(minutes: float) -> None:
    rows = TIME < 60.0 * minutes
    velocity = np.tile([4.0 * math.cos(0.3), 4.0 * math.sin(0.3)], (int(rows.sum()), 1))
    (seen,) = north_seen("rover", TIME[rows], np.full(rows.sum(), 0.2), velocity, NOWHERE[rows, 0])
    assert not seen.told and seen.sigma_rad > 3.0 * DEG
    north = TrueNorth.of(WORLD, [seen])
    assert north.turn_rad == WORLD.declination_rad and north.sigma_rad == WORLD.declination_sigma_rad
    assert "go through all headings" in north.words() and list(north.proofs(1)) == []


def test_slip_that_lasts_is_not_averaged_by_the_number_of_fixes() -> None:
    """A hundred times as many readings of one wander are no surer."""
    slip = np.repeat(np.random.default_rng(3).normal(0.0, 1.0 * DEG, 12), 60)
    seen = by_course(ROUND, ROUND + slip, 4.0)
    assert 0.15 * DEG < seen.chance_rad < 0.6 * DEG
    assert abs(seen.turn_rad - slip.mean()) < 2.0 * seen.chance_rad


def test_what_flies_sideways_has_no_course_and_an_antenna_tells_it_directly() -> None:
    velocity = np.stack([4.0 * np.cos(ROUND), 4.0 * np.sin(ROUND)], axis=1)
    assert north_seen("copter", TIME, ROUND, velocity, NOWHERE[:, 0]) == ()
    (seen,) = north_seen("copter", TIME, ROUND, NOWHERE, ROUND + 0.1)
    assert seen.by == "gps-yaw" and seen.steady_rad == ANTENNA_RAD
    assert seen.turn_rad == pytest.approx(0.1, abs=1e-6)


def test_what_goes_back_as_often_as_ahead_tells_nothing_and_a_little_of_it_is_left_out() -> None:
    back = np.where(TIME % 100.0 < 10.0, math.pi, 0.0)
    assert by_course(ROUND, ROUND + 0.1 + back, 4.0).turn_rad == pytest.approx(0.1, abs=0.01 * DEG)
    half = ROUND + np.where(TIME % 100.0 < 50.0, math.pi, 0.0)
    velocity = np.stack([4.0 * np.cos(half), 4.0 * np.sin(half)], axis=1)
    assert north_seen("rover", TIME, ROUND, velocity, NOWHERE[:, 0]) == ()


@given(st.floats(-5.0, 5.0), st.floats(0.05, 0.9), st.floats(0.1, 1.5))
def test_it_is_combined_with_the_model_by_inverse_variance(off: float, chance: float, steady: float) -> None:
    seen = NorthSeen("gps-course", WORLD.declination_rad + off * DEG, chance * DEG, steady * DEG, 600.0)
    north = TrueNorth.of(WORLD, [seen])
    model = 1.0 / (MOUNTED_RAD**2 + WORLD.declination_sigma_rad**2)
    mine = 1.0 / seen.sigma_rad**2
    assert north.sigma_rad == pytest.approx((model + mine) ** -0.5)
    beyond = float(wrap_pi(north.turn_rad - WORLD.declination_rad))
    assert beyond == pytest.approx(off * DEG * mine / (model + mine), abs=1e-12)
    ((said, off_deg, _),) = north.proofs(2)
    assert off_deg == pytest.approx(off, abs=1e-9) and "10 minutes of course" in said and "compass 2" in said


def test_a_compass_that_is_set_wrong_is_no_declination() -> None:
    seen = NorthSeen("gps-course", WORLD.declination_rad + math.pi / 2.0, 0.1 * DEG, 0.2 * DEG, 600.0)
    north = TrueNorth.of(WORLD, [seen])
    assert north.turn_rad == WORLD.declination_rad and "mounted so far off" in north.words()
    assert [off for _, off, _ in north.proofs(1)] == pytest.approx([90.0])


def test_a_recording_of_others_shows_its_declination_by_course_and_by_antenna(shared_data: Path) -> None:
    """By hand: the mean of course less heading, over all fixes above 2 m/s, is 5.3 deg; WMM says 5.4."""
    track = read_track(str(shared_data / "gap-foreign" / "c1010" / "flight.tlog"))
    world = earth_field_of(track)
    found = heading_of_track(track)
    assert world is not None and found.north is not None and found.true_rad is not None
    assert {seen.by for seen in found.north.learnt} == {"gps-course", "gps-yaw"}
    for seen in found.north.learnt:
        assert abs(float(wrap_pi(seen.turn_rad - world.declination_rad))) < 2.0 * seen.sigma_rad
    assert math.degrees(found.north.turn_rad) == pytest.approx(5.3, abs=0.4)
    ahead = np.asarray(wrap_pi(found.true_rad - found.magnetic_rad))
    assert ahead == pytest.approx(np.full(ahead.size, found.north.turn_rad))
