"""The tilt of a position: by the accelerometer, Newton and the estimator, each by what it is worth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.observation.tilt import (
    TILT_FLOOR_RAD,
    _add_estimator,
    _mean_force,
    _swinging,
    _uneven,
    _weighed,
    tilt_during,
)
from mavcompass.calibration.observation.upright import upright
from mavcompass.frames import FloatArray
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

G = STANDARD_GRAVITY_MPS2
TIME = np.arange(41.0) * 0.1
DEG = math.radians(1.0)
FLOOR = 0.02 * DEG
# Of mean 0 and variance 1 over every three readings.
NOISE = math.sqrt(1.5) * np.array([-1.0, 0.0, 1.0])[np.arange(41) % 3][:, np.newaxis]


def force(roll_deg: float, pitch_deg: float, g: float = G) -> FloatArray:
    roll, pitch = roll_deg * DEG, pitch_deg * DEG
    return -g * np.array(
        [-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)]
    )


def level_track(vehicle: str = "boat", **more: Any) -> Track:
    return Track(vehicle=vehicle, **more)


def told(track: Track, lag_sigma_s: float = 0.0) -> tuple[float, float, float]:
    roll, pitch, sigma, _ = tilt_during(track, TIME, lag_sigma_s)
    return roll / DEG, pitch / DEG, sigma / DEG


def attitude(roll_deg: FloatArray | float, pitch_deg: FloatArray | float = 0.0) -> Series:
    return Series.of(TIME, np.stack(np.broadcast_arrays(roll_deg * DEG, pitch_deg * DEG, 0.0 * TIME), axis=1))


def test_level_where_nothing_was_recorded() -> None:
    assert told(level_track()) == pytest.approx((0.0, 0.0, 0.02 * math.sqrt(2.0)))
    assert np.isnan(tilt_during(level_track(), TIME)[3]).all()


def test_what_stands_is_as_level_as_its_accelerometer_says() -> None:
    still = Series.of(TIME, np.tile(force(3.0, -2.0), (41, 1)))
    assert told(level_track(acc_mps2=still)) == pytest.approx((3.0, -2.0, 0.02))
    assert tilt_during(level_track(acc_mps2=still), TIME)[3] == pytest.approx(force(3.0, -2.0))
    gap = np.tile(force(3.0, -2.0), (41, 1))
    gap[5:20] = np.nan
    assert told(level_track(acc_mps2=Series.of(TIME, gap)))[:2] == pytest.approx((3.0, -2.0))


@pytest.mark.parametrize(
    ("share", "is_gravity"), [(1.059, True), (1.061, False), (0.941, True), (0.939, False)]
)
def test_a_force_six_hundredths_from_gravity_is_not_gravity_alone(share: float, is_gravity: bool) -> None:
    pushed = Series.of(TIME, np.tile(force(3.0, 0.0, share * G), (41, 1)))
    roll, _, sigma = told(level_track(acc_mps2=pushed, attitude_rad=attitude(1.0)))
    assert roll == pytest.approx(3.0 if is_gravity else 1.0, abs=0.1)
    assert is_gravity or sigma == pytest.approx(math.hypot(0.15, 0.02))  # the estimator's own


def test_shaking_makes_the_mean_force_less_certain() -> None:
    shaken = Series.of(TIME, force(0.0, 0.0) + 0.3 * NOISE * [1.0, 0.5, 0.2])
    mean, sigma = _mean_force(level_track(acc_mps2=shaken), 0.0, 4.0)
    assert mean == pytest.approx(force(0.0, 0.0), abs=0.01)
    assert sigma == pytest.approx(0.3 / math.sqrt(41.0) / G, rel=0.02)
    # Shaking lasts for 50 ms: five times as many readings in the time tell half of what they would.
    often = Series.of(
        np.arange(201.0) * 0.02, force(0.0, 0.0) + 0.3 * np.resize(NOISE, (201, 1)) * [1.0, 0.5, 0.2]
    )
    _, again = _mean_force(level_track(acc_mps2=often), 0.0, 4.0)
    assert again == pytest.approx(0.3 * math.sqrt(2.5 / 201.0) / G, rel=0.02)


def test_three_readings_make_a_mean_force() -> None:
    still = level_track(acc_mps2=Series.of(TIME, np.tile(force(1.0, 0.0), (41, 1))))
    assert math.isnan(_mean_force(still, 0.0, 0.1)[1]) and _mean_force(still, 0.0, 0.2)[1] == 0.0


def test_a_force_in_whole_numbers_is_unsure_by_its_step() -> None:
    step = 0.01 * G
    cut = np.trunc(force(0.0, 3.0) / step) * step
    track = level_track(acc_mps2=Series.of(TIME, np.tile(cut, (41, 1))), acc_truncation_mps2=step)
    mean, sigma = _mean_force(track, 0.0, 4.0)
    assert mean[0] == pytest.approx(cut[0] + 0.5 * step) and mean[2] == pytest.approx(cut[2] - 0.5 * step)
    assert sigma == pytest.approx(0.01 * 2.0 / math.sqrt(12.0))  # of y: anything about zero


def test_wheels_that_roll_on_show_in_quarters_of_a_second() -> None:
    values = np.tile(force(0.0, 0.0), (48, 1))
    values[:24, 0] += 1.0  # brakes in the first half: eight blocks of each
    blocks = np.array([1.0] * 8 + [0.0] * 8)
    assert _uneven(values, 0.0, 4.0) == pytest.approx(blocks.std(ddof=1) / 4.0)
    assert _uneven(values, 0.0, 0.3) == 0.0  # one block tells nothing
    values[:, 2] += values[:, 0]
    assert _uneven(values, 0.0, 4.0) == pytest.approx(blocks.std(ddof=1) / 4.0)  # up and down does not tilt
    rolling = Series.of(np.linspace(0.0, 3.9, 48), values)
    assert _mean_force(Track(vehicle="rover", acc_mps2=rolling), 0.0, 4.0)[1] == pytest.approx(
        blocks.std(ddof=1) / 4.0 / G, rel=0.1
    )
    assert _mean_force(Track(vehicle="boat", acc_mps2=rolling), 0.0, 4.0)[1] < 0.1 / G


def test_witnesses_count_by_their_variance() -> None:
    down, other = np.array([0.0, 0.0, 1.0]), np.array([0.0, 3e-5, 1.0])
    mean, sigma = _weighed([(down, 0.02), (other, 0.01)])
    assert mean == pytest.approx([0.0, 3e-5 * 0.8, 1.0], rel=1e-3)
    assert sigma == pytest.approx(math.sqrt(1.0 / (1.0 / 0.02**2 + 1.0 / 0.01**2)), rel=1e-3)
    _, alone = _weighed([(down, 0.0)])
    assert alone == pytest.approx(FLOOR) and TILT_FLOOR_RAD == FLOOR


def test_witnesses_that_contradict_each_other_are_less_certain() -> None:
    mean, sigma = _weighed([(np.array([0.0, 0.1, 1.0]), 0.01), (np.array([0.0, -0.1, 1.0]), 0.01)])
    assert mean == pytest.approx([0.0, 0.0, 1.0])
    # 0.1 on each side, of one of two angles, at 0.01 each: a hundredfold variance.
    assert sigma == pytest.approx(0.01 * math.sqrt(100.0 / 2.0), rel=1e-3)


def test_a_swing_is_unsure_by_its_size_and_by_the_lag() -> None:
    angle = 0.2 * np.sin(np.linspace(-0.5 * math.pi, 0.5 * math.pi, 101))
    down = np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    bend, late = _swinging(down, 4.0, 0.03)
    assert bend == pytest.approx(0.5 * 0.2**2 * 0.5, rel=0.03)
    assert late == pytest.approx(2.0 * math.sin(0.2) * 0.03 / 4.0)
    assert _swinging(down[:1], 0.0, 0.03) == (0.0, 0.0)


def test_the_estimator_is_smooth_and_off_by_a_little() -> None:
    tilts: list[tuple[FloatArray, float]] = []
    _add_estimator(level_track(attitude_rad=attitude(4.0, -3.0)), 0.0, 4.0, tilts, False)
    ((down, sigma),) = tilts
    assert -G * down == pytest.approx(force(4.0, -3.0)) and sigma == pytest.approx(0.15 * DEG)
    two = Series.of(TIME[:2], np.zeros((2, 3)))
    for nothing in (level_track(), level_track(attitude_rad=two)):
        _add_estimator(nothing, 0.0, 4.0, tilts, False)
    assert len(tilts) == 1
    _add_estimator(level_track(attitude_rad=attitude(0.0)), 3.75, 4.0, tilts, False)
    assert len(tilts) == 2  # three readings are enough


@pytest.mark.parametrize(("bent_deg", "own_deg"), [(0.1, 0.0), (0.4, 0.0), (2.0, 0.0), (-2.0, 0.5)])
def test_an_estimator_counts_less_by_as_much_as_it_contradicts(bent_deg: float, own_deg: float) -> None:
    other = (np.array([0.0, 0.0, 1.0]), own_deg * DEG)
    tilts = [other]
    _add_estimator(level_track(attitude_rad=attitude(bent_deg)), 0.0, 4.0, tilts, True)
    beyond = max(0.5 * bent_deg**2 - 0.3**2 - own_deg**2 - 0.02**2, 0.0)
    assert tilts[1][1] / DEG == pytest.approx(math.sqrt(0.3**2 + beyond), rel=1e-3)


def test_what_flies_does_not_believe_its_accelerometer_alone() -> None:
    still = Series.of(TIME, np.tile(force(3.0, 0.0), (41, 1)))
    # Without a gyro Newton says nothing: the force and the estimator, as far as these are good.
    roll, _, sigma = told(Track(vehicle="copter", acc_mps2=still, attitude_rad=attitude(3.0)))
    assert roll == pytest.approx(3.0) and sigma == pytest.approx(0.02, rel=0.02)


def test_the_lag_matters_while_it_tilts() -> None:
    leaning = level_track(attitude_rad=attitude(2.0 * TIME))
    sure, unsure = told(leaning)[2], told(leaning, 0.03)[2]
    assert math.sqrt(unsure**2 - sure**2) == pytest.approx(2.0 * 0.03, rel=0.01)


def hovering(bent_deg: FloatArray | float) -> Track:
    """Make a level copter that stands in the air, and an estimator that leans."""
    time = 0.05 * np.arange(601)
    lean = np.broadcast_to(np.asarray(bent_deg) * DEG, time.shape)
    return Track(
        vehicle="copter",
        acc_mps2=Series.of(time, np.tile(force(0.0, 0.0), (601, 1))),
        gyro_radps=Series.of(time, np.zeros((601, 3))),
        attitude_rad=Series.of(time, np.stack([lean, 0.0 * time, 0.0 * time], axis=1)),
        gps_velocity_mps=Series.of(time[::4], np.zeros((151, 3))),
    )


@pytest.mark.parametrize("bent_deg", [0.0, 0.2, 2.0])
def test_an_estimator_in_flight_is_doubted_by_how_far_it_lies_from_newton(bent_deg: float) -> None:
    found = upright(hovering(bent_deg))
    assert found is not None and found.track.attitude_rad is not None
    doubt = max(math.sqrt(0.5) * bent_deg, 0.3)  # each of two angles
    sigma = found.sigma_rad.at(15.0) / DEG
    newton = 1.0 / math.sqrt(sigma**-2 - doubt**-2)
    assert newton == pytest.approx(0.05, abs=0.01)
    left = bent_deg * (sigma / doubt) ** 2
    assert found.track.attitude_rad.at(15.0)[0] / DEG == pytest.approx(left, abs=0.02)
