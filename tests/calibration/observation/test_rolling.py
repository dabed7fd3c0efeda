"""Wheels that still roll: braking leans the accelerometer, and no gyro sees it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcompass.calibration.observation import StillnessDetector, find_dwells, rolls
from mavcompass.calibration.observation.rolling import RollingWitness, force_step, least_step_mps2
from mavcompass.calibration.observation.tilt import tilt_during
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

TIME = np.arange(0.0, 12.0, 0.02)
BRAKES_S, STANDS_S = 5.0, 6.2
REST = slice(*np.searchsorted(TIME, [STANDS_S + 0.3, 12.0]))


def stopping(vehicle: str = "rover", braking_mps2: float = 1.0, nod_rad: float = 0.0) -> Track:
    """Make a vehicle that drives on, brakes to a halt and stands; `nod_rad` is how it leans from then on."""
    rng = np.random.default_rng(5)
    brakes = (TIME >= BRAKES_S) & (TIME < STANDS_S)
    pitch = nod_rad * np.clip(np.interp(TIME, [BRAKES_S, BRAKES_S + 0.3], [0.0, 1.0]), 0.0, 1.0)
    along = STANDARD_GRAVITY_MPS2 * np.sin(pitch) - braking_mps2 * brakes
    force = np.column_stack([along, np.zeros(TIME.size), -STANDARD_GRAVITY_MPS2 * np.cos(pitch)])
    rate = np.column_stack([np.zeros(TIME.size), np.gradient(pitch, 0.02), np.zeros(TIME.size)])
    field = np.column_stack([np.full(TIME.size, 200.0), np.zeros(TIME.size), np.full(TIME.size, -500.0)])
    return Track(
        autopilot="ardupilot",
        vehicle=vehicle,
        compasses={1: MagSeries(1, Series.of(TIME[::5], field[::5] + rng.normal(0.0, 1.0, (120, 3))))},
        acc_mps2=Series.of(TIME, force + rng.normal(0.0, 0.02, force.shape)),
        gyro_radps=Series.of(TIME, rate + rng.normal(0.0, 0.001, rate.shape)),
    )


def test_a_turn_of_gravity_is_no_step_of_the_force() -> None:
    down = np.array([0.0, 0.0, -STANDARD_GRAVITY_MPS2])
    before, after = (
        np.reshape(rotation_matrix(r, p, 0.7), (3, 3)).T @ down for r, p in ((0.0, 0.0), (0.03, 0.02))
    )
    assert np.linalg.norm(after - before) > 0.3
    assert force_step(before, after, np.array([0.03, 0.02, 0.0])) < 0.01
    pushed = after + np.array([0.2, 0.0, 0.0])
    assert force_step(before, pushed, np.array([0.03, 0.02, 0.0])) == pytest.approx(0.2, abs=0.01)


def test_rolling_is_seen_where_braking_begins_and_ends() -> None:
    rolling = rolls(stopping(), TIME)
    assert rolling[np.abs(TIME - BRAKES_S) < 0.15].all() and rolling[np.abs(TIME - STANDS_S) < 0.15].all()
    assert not rolling[REST].any() and not rolling[TIME < BRAKES_S - 0.3].any()


@pytest.mark.parametrize("track", [stopping(braking_mps2=0.0), stopping(braking_mps2=0.0, nod_rad=0.03)])
def test_what_stands_or_tilts_does_not_roll(track: Track) -> None:
    assert not rolls(track, TIME).any()


def test_what_has_no_wheels_does_not_roll() -> None:
    assert not rolls(stopping("boat"), TIME).any()


def test_the_position_begins_when_the_wheels_have_stopped() -> None:
    dwells = find_dwells(stopping())
    assert dwells[-1].start_s > STANDS_S and dwells[-1].end_s > 11.0
    assert abs(dwells[-1].pitch_rad) < math.radians(0.1)
    assert all(dwell.end_s < BRAKES_S or dwell.start_s > STANDS_S for dwell in dwells)


def test_braking_is_not_taken_for_a_lean() -> None:
    track = stopping()
    _, pitch, sigma, _ = tilt_during(track, TIME[(TIME > 5.6) & (TIME < 7.3)])
    assert abs(pitch) < math.radians(0.3) and abs(pitch) < 3.0 * sigma


def still_from(track: Track, wheels: bool) -> FloatArray:
    detector = StillnessDetector(hold_s=0.0, wheels=wheels)
    assert track.acc_mps2 is not None and track.gyro_radps is not None
    said = [
        detector.update(float(t), gyro, acc, (200.0, 0.0, -500.0)).still
        for t, gyro, acc in zip(TIME, track.gyro_radps.values, track.acc_mps2.values, strict=True)
    ]
    return np.array(said)


def test_live_a_dwell_does_not_begin_while_it_brakes() -> None:
    still = still_from(stopping(), wheels=True)
    assert not still[(TIME > STANDS_S + 0.05) & (TIME < STANDS_S + 0.4)].any()
    assert still[TIME > STANDS_S + 0.55].all() and still[(TIME > 2.0) & (TIME < BRAKES_S)].all()
    assert still_from(stopping(), wheels=False)[TIME > 2.0].all()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("rate_radps", [0.1, -0.1])
def test_live_a_body_that_nods_does_not_roll(axis: int, rate_radps: float) -> None:
    witness = RollingWitness()
    gyro = [0.0, 0.0, 0.0]
    gyro[axis] = rate_radps
    for time_s in TIME[:60].tolist():
        angles = [0.0, 0.0]
        angles[axis] = rate_radps * time_s
        turned = np.reshape(rotation_matrix(*angles, 0.0), (3, 3))
        witness.hear(time_s, tuple(gyro), tuple((turned.T @ [0.0, 0.0, -STANDARD_GRAVITY_MPS2]).tolist()))
        assert not witness.rolls(0.0)  # 0.25 m/s^2 in a quarter of a second, of which the turn explains all
    witness.hear(TIME[60], tuple(gyro), (3.0, 0.0, -9.8))
    assert witness.rolls(0.0) and not witness.rolls(9.0)


@pytest.mark.parametrize("every", [1, 2, 4])
@pytest.mark.parametrize(("of_least", "is_seen"), [(1.7, True), (0.4, False)])
def test_a_change_is_one_beyond_the_noise_of_a_quarter_of_a_second(
    every: int, of_least: float, is_seen: bool
) -> None:
    """However often it is read: 0.08 m/s^2, and five sigmas of the difference of two means."""
    track = stopping(braking_mps2=0.0)
    assert track.acc_mps2 is not None
    time, rng = TIME[::every], np.random.default_rng(6)
    least = least_step_mps2(0.1, 0.25 / (0.02 * every))
    assert least == pytest.approx(math.hypot(0.08, 0.5 * math.sqrt(2.0 * 0.02 * every / 0.25)))
    force = np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (time.size, 1)) + 0.1 * rng.normal(
        size=(time.size, 3)
    )
    force[time >= BRAKES_S, 0] -= of_least * least
    seen = rolls(replace(track, acc_mps2=Series.of(time, force)), TIME)
    assert bool(seen.any()) is is_seen
    assert not seen[np.abs(TIME - BRAKES_S) > 0.3].any()


def test_few_readings_are_no_witness() -> None:
    assert (
        least_step_mps2(0.1, 0.5)
        == least_step_mps2(0.1, 1.0)
        == pytest.approx(math.hypot(0.08, 0.5 * 2**0.5))
    )
    braking = stopping(braking_mps2=3.0)
    assert braking.acc_mps2 is not None and braking.gyro_radps is not None
    for count, tells in ((7, False), (8, True)):
        at = np.linspace(4.7, 5.3, count)
        few = Series.of(at, braking.acc_mps2.at(at))
        assert rolls(replace(braking, acc_mps2=few), TIME).any() == tells
    assert not rolls(braking, TIME[TIME < 5.02][-2:]).any() and rolls(braking, TIME[TIME < 5.02][-3:]).any()
    for nothing in (replace(braking, acc_mps2=None), replace(braking, gyro_radps=None)):
        assert not rolls(nothing, TIME).any()


def test_live_a_quarter_of_a_second_is_held_against_the_one_before() -> None:
    """At eighths of a second, which are exact: what is a quarter old belongs to the part before."""
    witness = RollingWitness()
    for eighth, force in enumerate((0.0, 0.0, 0.0, 1.0, 1.0)):
        witness.hear(0.125 * eighth, (0.0, 0.0, 0.0), (force, 0.0, -9.8))
    # 0 to 0.25 s before, 0.375 and 0.5 s after: 0 and 1 m/s^2, of three and two readings.
    assert witness.rolls(0.19) and not witness.rolls(0.21)
    assert len(witness._felt) == 5
    witness.hear(0.625, (0.0, 0.0, 0.0), (1.0, 0.0, -9.8))
    assert witness._felt[0][0] == 0.125
