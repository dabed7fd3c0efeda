"""Wheels that still roll: braking leans the accelerometer, and no gyro sees it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation import StillnessDetector, find_dwells
from mavcompass.calibration.observation.detector import RollingWitness
from mavcompass.calibration.observation.dwells import tilt_during
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

TIME = np.arange(0.0, 12.0, 0.02)
BRAKES_S, STANDS_S = 5.0, 6.2


def stopping() -> Track:
    """Make a rover that drives on, brakes to a halt and stands."""
    rng, still = np.random.default_rng(5), np.zeros((TIME.size, 3))
    force = np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (TIME.size, 1))
    force[(TIME >= BRAKES_S) & (TIME < STANDS_S), 0] = -1.0
    field = np.tile([200.0, 0.0, -500.0], (TIME[::5].size, 1))
    return Track(
        autopilot="ardupilot",
        vehicle="rover",
        compasses={1: MagSeries(1, Series.of(TIME[::5], field + rng.normal(0.0, 1.0, field.shape)))},
        acc_mps2=Series.of(TIME, force + rng.normal(0.0, 0.02, force.shape)),
        gyro_radps=Series.of(TIME, still + rng.normal(0.0, 0.001, still.shape)),
    )


def test_who_brakes_within_a_position_leans_as_it_does() -> None:
    dwell = find_dwells(stopping())[-1]
    assert dwell.start_s < BRAKES_S and dwell.end_s > 11.0
    assert abs(dwell.pitch_rad) < min(math.radians(0.15), 2.0 * dwell.tilt_sigma_rad)


def test_braking_is_not_taken_for_a_lean() -> None:
    track = stopping()
    _, pitch, sigma = tilt_during(track, TIME[(TIME > 5.6) & (TIME < 7.3)])
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
