"""One turn all the way round without a stop is as good as standing still at its quarters."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_worlds import FIELD, heading_errors, iron_of, rms, turning_track

from mavcompass.calibration import calibrate_track
from mavcompass.calibration.methods.four_positions_textbook import four_readings
from mavcompass.correction import FieldCorrection
from mavcompass.track import Series, Track

IRON = iron_of(FieldCorrection((60.0, -40.0, 25.0), (1.08, 0.93, 1.0), (0.02, 0.0, 0.0)))
# A raised cosine: at 80 degrees a second in the middle, at rest at its ends.
TURN_S = 9.0
TURN = [(1.1, 2.0 + TURN_S)]


def one_turn(seed: int = 1, noise: float = 0.0, gyro_noise: float = 0.0, by_deg: float = 360.0) -> Track:
    return turning_track(
        IRON, dwell_s=2.0, turn_s=TURN_S, turns_deg=(by_deg,), noise=noise, gyro_noise=gyro_noise, seed=seed
    )


@pytest.mark.parametrize("alpha", [0.0, 0.7, 2.0, -1.0])
def test_the_means_of_four_quarters_give_the_papers_offset_and_the_chord_of_its_amplitude(
    alpha: float,
) -> None:
    quarter = alpha + (np.arange(10_000) + 0.5) / 10_000 * 0.5 * math.pi
    means = [float((150.0 * np.sin(quarter + k * 0.5 * math.pi) + 40.0).mean()) for k in range(4)]
    solved = four_readings(means)
    chord = math.sin(math.pi / 4.0) / (math.pi / 4.0)
    assert solved.offset == pytest.approx(40.0) and solved.amplitude == pytest.approx(150.0 * chord)
    assert math.remainder(solved.alpha_rad - alpha - math.pi / 4.0, 2.0 * math.pi) == pytest.approx(0.0)
    assert solved.left_over == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("by_deg", [360.0, -360.0, 270.0])
def test_without_noise_an_uneven_turn_gives_the_iron_back(by_deg: float) -> None:
    result = calibrate_track(one_turn(by_deg=by_deg), "world-field", earth=FIELD, windows=TURN)
    assert result.accepted and rms(heading_errors(result.correction, IRON)) < 0.02


def test_what_is_claimed_of_a_noisy_turn_is_what_it_is_off_by() -> None:
    off, claimed = [], []
    for seed in range(12):
        track = one_turn(seed, noise=6.0, gyro_noise=0.01)
        result = calibrate_track(track, "world-field", earth=FIELD, windows=TURN)
        off.append(rms(heading_errors(result.correction, IRON)))
        claimed.append(result.heading_sigma_deg)
    assert 0.3 * rms(np.array(claimed)) < rms(np.array(off)) < rms(np.array(claimed)) < 0.7


def test_what_lies_outside_of_the_stretches_does_not_count() -> None:
    """Steel that was there before the turn began is no iron of the vehicle's."""
    track = one_turn(noise=1.0, gyro_noise=0.002)
    before = (track.compasses[1].time_s < 1.0)[:, np.newaxis] * [80.0, -60.0, 0.0]
    compass = track.compasses[1]
    reported = Series.of(compass.time_s, compass.reported.values + before)
    beside = replace(track, compasses={1: replace(compass, reported=reported)})
    off = [
        rms(heading_errors(calibrate_track(beside, "world-field", earth=FIELD, windows=w).correction, IRON))
        for w in (TURN, [(0.0, TURN[0][1])])
    ]
    assert off[0] < 0.1 < off[1]
