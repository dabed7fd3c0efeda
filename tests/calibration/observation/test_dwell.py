"""What a still position holds: a mean of readings that are fresh, sound and free of what was done to them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation import Dwell, FourPositionData, dwell_between
from mavcompass.calibration.observation.dwells import UNSEEN_BIAS_RAD, _memory, accelerometer_sigma_rad
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body
from mavcompass.track import InForce, MagSeries, Series, Track

TIME = np.arange(300.0) * 0.1
FIELD = np.array([200.0, -50.0, 400.0])
# Of mean 0 and variance 1, whichever three follow each other.
NOISE = np.tile(math.sqrt(1.5) * np.array([-1.0, 0.0, 1.0]), 100)[:, np.newaxis]
SWING = FieldCorrection(offsets_mgauss=(30.0, -20.0, 10.0), diagonals=(1.1, 0.9, 1.0))


def standing(
    field: FloatArray, turned: FloatArray | None = None, autopilot: str = "unknown", **more: Any
) -> Track:
    """Make a level recording whose nose turns by an angle, (N,)."""
    still = np.zeros((300, 3))
    if turned is not None:
        still[:, 2] = np.gradient(turned, TIME)
    compass = MagSeries(1, Series.of(TIME, field), **more)
    return Track(autopilot=autopilot, compasses={1: compass}, gyro_radps=Series.of(TIME, still))


def dwell(
    field: FloatArray, turned: FloatArray | None = None, autopilot: str = "unknown", **more: Any
) -> Dwell:
    return dwell_between(standing(field, turned, autopilot, **more), 1, 0.0, 6.0)


def test_the_mean_is_as_sure_as_its_readings_are_many() -> None:
    noise = 2.0 * NOISE * np.array([1.0, 2.0, 0.5])
    found = dwell(FIELD + noise)
    assert (found.start_s, found.end_s, found.samples) == pytest.approx((0.0, 5.9, 60))
    assert found.mean_mgauss == pytest.approx(FIELD)
    assert np.sqrt(np.diag(found.covariance_mgauss2)) == pytest.approx(
        2.0 * np.array([1.0, 2.0, 0.5]) / math.sqrt(59.0)
    )
    assert not found.quantisation_mgauss2.any() and found.unsteady_mgauss == 0.0
    assert found.swing == pytest.approx(np.eye(3)) and found.turned_rad == pytest.approx(0.0)
    assert math.isnan(found.current_a)


def test_what_a_position_sways_is_not_its_compass_noise() -> None:
    """A boat rolls by two degrees, 14 mG to and fro, which the level explains: the noise is 1 mG."""
    time = np.arange(3000) * 0.01
    roll, rate = 0.035 * np.sin(2.0 * time), 0.07 * np.cos(2.0 * time)
    body = level_to_body(roll, 0.0 * roll)
    rolling = np.stack([rate, 0.0 * rate, 0.0 * rate], axis=1)
    rng = np.random.default_rng(4)
    force = body @ [0.0, 0.0, -9.80665] + 0.02 * rng.standard_normal((3000, 3))
    field = (body @ FIELD)[::10] + rng.standard_normal((300, 3))
    track = Track(
        compasses={1: MagSeries(1, Series.of(TIME, field))},
        gyro_radps=Series.of(time, rolling),
        acc_mps2=Series.of(time, force),
        vehicle="boat",
    )
    found = dwell_between(track, 1, 9.0, 15.0)
    noise = np.sqrt(np.diag(found.covariance_mgauss2))
    assert noise == pytest.approx([1.0 / math.sqrt(60.0)] * 3, rel=0.35)
    mapping = level_to_body(found.roll_rad, found.pitch_rad) @ found.swing
    assert np.abs(found.mean_mgauss - mapping @ FIELD).max() < 5.0 * float(noise.max())


def test_a_reading_that_is_repeated_counts_once() -> None:
    slow = np.repeat(FIELD + 2.0 * NOISE[:100], 3, axis=0)
    assert dwell(slow).samples == 20
    assert dwell(slow).covariance_mgauss2[0, 0] == pytest.approx(4.0 / 20.0, rel=0.1)


@pytest.mark.parametrize(("sigmas", "counted"), [(4.9, 60), (5.1, 59), (-5.1, 59), (60.0, 59)])
def test_a_wild_reading_is_left_out(sigmas: float, counted: int) -> None:
    noisy = FIELD + 2.0 * NOISE
    noisy[31, 1] = FIELD[1] + sigmas * 1.4826 * 2.0 * math.sqrt(1.5)  # robust sigmas of the others
    assert dwell(noisy).samples == counted
    assert counted == 60 or dwell(noisy).mean_mgauss == pytest.approx(FIELD)


def test_what_half_of_them_say_is_not_wild() -> None:
    found = dwell(FIELD + 0.01 * NOISE + 60.0 * (np.arange(300) % 2)[:, np.newaxis])
    assert found.mean_mgauss == pytest.approx(FIELD + 30.0) and found.samples == 60
    few = FIELD + 0.01 * NOISE
    few[3] += 60.0
    assert dwell_between(standing(few), 1, 0.0, 0.35).samples == 4  # too few to judge
    assert dwell_between(standing(few), 1, 0.0, 0.45).samples == 4


def test_what_the_autopilot_had_done_is_undone() -> None:
    noise = NOISE * np.array([1.0, 1.0, 1.0])
    found = dwell(SWING.apply(FIELD + noise), in_force=(InForce(-np.inf, SWING),))
    assert found.mean_mgauss == pytest.approx(FIELD)
    assert np.sqrt(np.diag(found.covariance_mgauss2)) == pytest.approx([1.0 / math.sqrt(59.0)] * 3)


def test_a_correction_that_changes_while_it_stands_changes_nothing() -> None:
    changes = (InForce(-np.inf, FieldCorrection()), InForce(3.05, SWING))
    raw = FIELD + NOISE
    reported = np.where(TIME[:, np.newaxis] < 3.05, raw, SWING.apply(raw))
    found = dwell(reported, in_force=changes)
    assert found.mean_mgauss == pytest.approx(FIELD) and found.unsteady_mgauss == 0.0
    compass = standing(reported, in_force=changes).compasses[1]
    assert compass.correction_at(3.05) is SWING and compass.correction_at(3.04) is not SWING
    assert standing(reported, in_force=changes).raw_field(1, motors=False) == pytest.approx(raw)
    # The first holds before its time, too.
    late = (InForce(2.05, FieldCorrection()), InForce(3.05, SWING))
    assert standing(reported, in_force=late).raw_field(1, motors=False) == pytest.approx(raw)


def test_whole_numbers_are_taken_back() -> None:
    cut = np.tile(np.trunc([200.3, -50.3, 400.7]), (300, 1))
    found = dwell(cut, quantum_mgauss=1.0, truncated=True)
    # Anything within the step: its middle, and the step's sigma; an average hides no less of it.
    assert found.mean_mgauss == pytest.approx([200.5, -50.5, 400.5])
    assert np.sqrt(np.diag(found.quantisation_mgauss2)) == pytest.approx([1.0 / math.sqrt(12.0)] * 3)
    rounded = dwell(cut, quantum_mgauss=1.0)
    assert rounded.mean_mgauss == pytest.approx([200.0, -50.0, 400.0])
    track = standing(cut, quantum_mgauss=1.0, truncated=True)
    middle = track.centred(1)
    assert middle.compasses[1].reported.values[0] == pytest.approx([200.5, -50.5, 400.5])
    assert not middle.compasses[1].truncated and middle.centred(1) is middle


@pytest.mark.parametrize(("degrees", "sigma_mgauss"), [(4.0, 0.1), (20.0, 2.0)])
def test_a_swing_inside_a_position_is_reckoned_with(degrees: float, sigma_mgauss: float) -> None:
    turned = math.radians(degrees) * np.sin(2.0 * math.pi * TIME / 6.0)
    psi = 0.7 + turned
    field = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(300, 400.0)], axis=1)
    found = dwell(field, turned, "px4")
    exact = np.exp(1j * turned[:60]).mean()
    assert found.swing[0, 0] == pytest.approx(abs(exact), rel=1e-3) and found.swing[0, 0] < 0.9999
    assert found.turned_rad == pytest.approx(float(np.angle(exact)), abs=0.002)
    level = found.mean_mgauss[0] - 1j * found.mean_mgauss[1]
    assert level == pytest.approx(200.0 * np.exp(0.7j) * exact, rel=3e-3)
    # What follows the turn is neither noise nor unrest.
    assert found.unsteady_mgauss == 0.0
    assert math.sqrt(np.diag(found.covariance_mgauss2).max()) < sigma_mgauss


def test_the_field_lags_behind_the_gyro() -> None:
    turned = math.radians(2.0) * TIME
    level = FIELD + NOISE
    heard = dwell_between(standing(level, turned, autopilot="ardupilot"), 1, 1.0, 5.0)
    plain = dwell_between(standing(level, turned, "px4"), 1, 1.0, 5.0)
    assert heard.turned_rad == pytest.approx(plain.turned_rad - math.radians(2.0) * 0.09)
    assert heard.turned_sigma_rad == pytest.approx(math.radians(2.0) * 0.03)
    assert Track(autopilot="px4").field_lag_s == 0.0 and Track(autopilot="ardupilot").field_lag_s == 0.09


def test_tilting_is_no_unrest() -> None:
    lean = np.where(TIME < 15.0, 0.0, 0.05)
    field = np.stack([200.0 - 400.0 * np.sin(lean), 0.0 * lean, 400.0 * np.cos(lean)], axis=1) + 0.3 * NOISE
    attitude = np.stack([0.0 * lean, lean, 0.0 * lean], axis=1)
    track = standing(field)
    assert dwell_between(track, 1, 0.0, 30.0).unsteady_mgauss == pytest.approx(20.0, rel=0.02)
    leaning = Track(
        compasses=track.compasses, gyro_radps=track.gyro_radps, attitude_rad=Series.of(TIME, attitude)
    )
    assert dwell_between(leaning, 1, 0.0, 30.0).unsteady_mgauss == 0.0


def test_a_position_needs_two_readings() -> None:
    field = FIELD + NOISE
    assert dwell_between(standing(field), 1, 0.95, 1.15).samples == 2
    with pytest.raises(PoorCalibration, match=r"has 1 readings between 0\.9 s and 1\.1 s"):
        dwell_between(standing(field), 1, 0.95, 1.05)
    field[10:20] = np.nan
    with pytest.raises(PoorCalibration):
        dwell_between(standing(field), 1, 0.85, 1.85)
    with pytest.raises(KeyError):
        dwell_between(standing(field), 2, 0.0, 1.0)


def test_without_a_gyro_the_angle_is_unknown() -> None:
    track = Track(compasses=standing(FIELD + NOISE).compasses)
    found = dwell_between(track, 1, 0.0, 6.0)
    assert math.isnan(found.turned_rad) and found.turned_sigma_rad == 0.0 and (found.swing == np.eye(3)).all()


def test_noise_that_lasts_averages_less() -> None:
    chance = np.random.default_rng(4)
    white = chance.normal(size=(20000, 3))
    slow = np.empty_like(white)
    slow[0] = white[0]
    for k in range(1, len(white)):
        slow[k] = 0.6 * slow[k - 1] + 0.8 * white[k]
    # The variance of a mean of an autoregression of 0.6: (1 + 0.6) / (1 - 0.6) times that of white noise.
    assert _memory(slow) == pytest.approx(4.0, rel=0.06)
    assert _memory(white) == 1.0 and _memory(slow[:7]) == 1.0 and _memory(0.0 * white) == 1.0
    assert _memory(np.ones((50, 3))) == pytest.approx(19.0)  # no more than that
    assert _memory(np.ones((8, 3))) > 1.0


def test_positions_and_turns_alternate() -> None:
    at = Dwell(0.0, 1.0, FIELD, np.eye(3))
    with pytest.raises(ValueError, match="2 dwells need 1 steps"):
        FourPositionData((at, at), ())


# --- What an accelerometer may be off by, seen from the lean that turns with the vehicle: equation (L1)


QUARTERS = np.radians([0.0, 90.0, 180.0, 270.0])
LEAN_NOISE = np.full(4, math.radians(0.03))


def seen(lean_deg: float, slope_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    lean, slope = math.radians(lean_deg), math.radians(slope_deg)
    return lean + slope * np.cos(QUARTERS), -slope * np.sin(QUARTERS)


def sigma_deg(lean_deg: float, slope_deg: float = 0.0) -> float:
    return math.degrees(accelerometer_sigma_rad(QUARTERS, *seen(lean_deg, slope_deg), LEAN_NOISE))


def test_what_stands_upright_has_a_good_accelerometer() -> None:
    assert sigma_deg(0.0) == pytest.approx(math.degrees(0.001), rel=0.15)


def test_a_lean_is_the_accelerometers_as_far_as_that_is_likely() -> None:
    assert sigma_deg(0.0) < sigma_deg(0.1) < sigma_deg(0.3) < sigma_deg(0.8)
    assert 0.3 < sigma_deg(0.8) < 0.8
    # So far over no accelerometer is: it is how the vehicle stands.
    assert sigma_deg(5.0) < sigma_deg(1.0)


@pytest.mark.parametrize("slope_deg", [1.0, 4.0])
def test_the_slope_of_the_ground_is_none_of_it(slope_deg: float) -> None:
    assert sigma_deg(0.0, slope_deg) == pytest.approx(sigma_deg(0.0), rel=0.2)


def test_without_a_turn_lean_and_slope_are_one() -> None:
    turned = np.zeros(4)
    flat = accelerometer_sigma_rad(turned, np.zeros(4), np.zeros(4), LEAN_NOISE)
    assert flat > 3.0 * accelerometer_sigma_rad(QUARTERS, np.zeros(4), np.zeros(4), LEAN_NOISE)


def test_what_shows_nothing_leaves_it_as_likely_as_before() -> None:
    """So that what travels, whose lean tells nothing, claims no less than what stands and shows little."""
    nothing = accelerometer_sigma_rad(QUARTERS, np.zeros(4), np.zeros(4), np.full(4, 10.0))
    assert nothing == pytest.approx(UNSEEN_BIAS_RAD, rel=0.05)
