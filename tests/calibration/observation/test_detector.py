"""Whether a vehicle stands still, reading by reading, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.observation import StillnessDetector, find_dwells
from mavcompass.calibration.observation.detector import RollingWitness, Stillness, WhiteNoise
from mavcompass.calibration.observation.dwells import tilt_during
from mavcompass.frames import FloatArray
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
UP, FIELD = (0.0, 0.0, -G), (200.0, 0.0, 400.0)
STEP_S = 0.02
Vector = tuple[float, float, float]


def fed(
    detector: StillnessDetector,
    seconds: float,
    start_s: float,
    gyro: Vector = (0.0, 0.0, 0.0),
    acc: Vector = UP,
    mag: Vector = FIELD,
) -> Stillness:
    said = None
    for k in range(1, round(seconds / STEP_S) + 1):
        said = detector.update(start_s + k * STEP_S, gyro, acc, mag)
    assert said is not None
    return said


def standing(hold_s: float = 1.0) -> StillnessDetector:
    detector = StillnessDetector(hold_s)
    assert detector.update(0.0, (0.0, 0.0, 0.0), UP, FIELD).why_not == "starting"
    assert fed(detector, 2.0, 0.0).still
    return detector


def test_it_is_still_after_the_hold_time() -> None:
    detector = StillnessDetector(hold_s=0.5)
    times = [k * 0.125 for k in range(9)]
    seen = [detector.update(t, (0.0, 0.0, 0.0), UP, FIELD).still for t in times]
    assert seen == [t >= 0.5 for t in times]


@pytest.mark.parametrize(
    ("deg_s", "said"), [(2.9, ""), (-2.9, ""), (3.1, "hunting"), (-8.9, "hunting"), (9.1, "rotating")]
)
def test_a_rate_is_hunting_then_turning(deg_s: float, said: str) -> None:
    state = fed(standing(), 0.6, 2.0, gyro=(0.0, 0.0, math.radians(deg_s)))
    assert state.why_not == said and state.still is (not said)
    assert math.degrees(state.rate_radps) == pytest.approx(deg_s)
    # The first step is a trapezoid: from no rate to this one.
    assert math.degrees(state.turned_rad) == pytest.approx(deg_s * (0.6 - 0.5 * STEP_S))
    assert math.isnan(state.since_s) is bool(said)


def test_the_turn_is_about_the_vertical_of_a_vehicle_that_leans() -> None:
    roll, pitch = math.radians(30.0), math.radians(-20.0)
    down = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
    acc = (-G * down[0], -G * down[1], -G * down[2])
    detector = StillnessDetector()
    detector.update(0.0, (0.0, 0.0, 0.0), acc, FIELD)
    rate = math.radians(20.0)
    state = fed(detector, 1.0, 0.0, (rate * down[0], rate * down[1], rate * down[2]), acc)
    assert state.rate_radps == pytest.approx(rate) and state.why_not == "rotating"
    # About an axis across it, it does not turn, but tilt.
    state = fed(detector, 1.0, 1.0, (0.0, rate * math.cos(roll), -rate * math.sin(roll)), acc)
    assert state.rate_radps == pytest.approx(0.0, abs=1e-9) and state.why_not == "tilting"


@pytest.mark.parametrize(("mgauss", "said"), [(59.0, True), (60.0, True), (61.0, False)])
def test_a_field_that_jumps_begins_anew(mgauss: float, said: bool) -> None:
    detector = standing()
    state = detector.update(2.02, (0.0, 0.0, 0.0), UP, (200.0, -mgauss, 400.0))
    assert state.still is said and (state.why_not == "") is said
    assert said or (state.since_s == 2.02 and state.why_not == "field changing")


def test_a_late_reading_changes_nothing() -> None:
    detector = standing()
    before = detector.update(2.02, (0.0, 0.0, 0.0), UP, FIELD)
    for time_s in (2.02, 1.0):
        assert detector.update(time_s, (0.0, 0.0, 5.0), (9.0, 0.0, 0.0), (900.0, 0.0, 0.0)) == before


def test_white_noise_is_found_beside_a_smooth_motion() -> None:
    chance, noise = np.random.default_rng(2), WhiteNoise()
    found = []
    for k in range(400):
        noise.hear((3.0 * k + chance.normal(), 0.01 * k * k + chance.normal(), 5.0 + chance.normal()))
        found.append(noise.sigma)
        assert (noise.sigma > 0.0) is (k >= 9)  # eight second differences of three samples each
    assert np.mean(found[50:]) == pytest.approx(1.0, abs=0.1)


def test_a_swing_of_fourteen_degrees_is_another_position() -> None:
    rate = (0.0, 0.0, math.radians(2.9))
    detector = standing()
    assert fed(detector, 4.8, 2.0, rate).still  # 13.9 degrees
    assert fed(detector, 0.1, 6.8, rate).why_not == "hunting"  # 14.2


# --- Wheels that still roll: braking leans the accelerometer, and no gyro sees it


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
