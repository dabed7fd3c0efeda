"""Calibration by any motion: exact on exact data, honest on disturbed data, and the cause named."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, heading_errors, iron_of, rms, turning_track

from mavcompass.calibration import calibrate_compasses, calibrate_track
from mavcompass.calibration.motion.left_out import Change, last_stretch
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.logs import read_track
from mavcompass.track import MagSeries, Series, Track, joined
from mavcompass.units import STANDARD_GRAVITY_MPS2

STRONG = FieldCorrection((60.0, -40.0, 25.0), (1.08, 0.93, 1.0), (0.02, 0.0, 0.0))
STEEL = Iron((-30.0, 70.0, -20.0))
ROUND = tuple(70.0 if k % 2 else 50.0 for k in range(9))


def driven(iron: Iron, **changes: object) -> Track:
    """A rover that turns round more than once, with short stops."""
    return turning_track(iron, dwell_s=2.0, turn_s=2.5, turns_deg=ROUND, **changes)  # type: ignore[arg-type]


def with_field(track: Track, added: FloatArray) -> Track:
    """Add a field (N, 3) to what the compass of a made-up track reads."""
    compass = track.compasses[1]
    reported = Series.of(compass.time_s, compass.reported.values + added)
    return replace(track, compasses={1: replace(compass, reported=reported)})


def thinned(series: Series | None, every: int) -> Series:
    assert series is not None
    return Series.of(series.time_s[::every], series.values[::every])


def gain_of(factor: float) -> Iron:
    return Iron((30.0, -20.0, 10.0), factor * np.eye(3))


def test_sections_without_noise_give_the_iron_back_exactly() -> None:
    """The mean over a section that turns and tilts obeys equation S1 without any error."""
    iron = iron_of(STRONG)
    track = driven(iron, noise=0.0, gyro_noise=0.0)
    fit = observe_motion(Recorded(track, earth=FIELD)).fit
    correction = FieldCorrection.from_matrix(-fit.offset_mgauss, np.linalg.inv(fit.gain))
    assert fit.error.mgauss == 0.0
    assert rms(heading_errors(correction, iron)) < 0.03


def test_halves_that_differ_by_more_than_two_sigmas_widen_the_claim(monkeypatch: pytest.MonkeyPatch) -> None:
    track, claims = driven(iron_of(STRONG), noise=30.0), []
    for ratio in (0.0, 1.9, 2.1, 4.2):
        monkeypatch.setattr(Motion, "halves_ratio", lambda _, ratio=ratio: ratio)
        claims.append(calibrate_track(track, "world-field", earth=FIELD))
    alike_deg, nearly_deg, apart_deg, further_deg = (claim.heading_sigma_deg for claim in claims)
    assert nearly_deg == alike_deg
    noise_deg = claims[0].heading_budget_deg["noise"]
    assert (apart_deg, further_deg) == pytest.approx((2.1 * noise_deg, 4.2 * noise_deg))


@pytest.mark.parametrize("first_deg", [0.0, 77.0, 181.0, 300.0])
def test_where_the_nose_points_at_the_start_does_not_matter(first_deg: float) -> None:
    iron = iron_of(STRONG)
    result = calibrate_track(driven(iron, first_deg=first_deg), "world-field", earth=FIELD)
    assert result.accepted, result.reasons
    assert rms(heading_errors(result.correction, iron)) < 0.15
    field = np.array([[100.0, -50.0, 300.0]])
    assert np.allclose(result.correction.undo(result.correction.apply(field)), field)


@pytest.mark.parametrize(("slope_deg", "uphill_rad"), [(3.0, 1.57), (3.0, 4.7), (6.0, 3.1)])
@pytest.mark.parametrize("first_deg", [15.0, 105.0])
def test_on_a_slope_no_fit_is_its_own_mirror_image(
    first_deg: float, slope_deg: float, uphill_rad: float
) -> None:
    """Half a turn away and all gains negative the level field is the same: the prior tells, not the tilt."""
    iron, slope = gain_of(1.0), math.radians(slope_deg)
    track = turning_track(iron, dwell_s=2.0, turn_s=2.5, turns_deg=2 * ROUND, first_deg=first_deg)
    assert track.gyro_radps is not None
    time, rate = track.gyro_radps.time_s, track.gyro_radps.values[:, 2]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    yaw = math.radians(first_deg) + turned
    rotation = euler_to_matrix(slope * np.sin(yaw - uphill_rad), slope * np.cos(yaw - uphill_rad), yaw)
    level = np.array([FIELD.horizontal_mgauss, 0.0, FIELD.ned_mgauss[2]])
    felt = np.array([0.0, 0.0, -STANDARD_GRAVITY_MPS2])
    reported, acc = (
        Series.of(time, rotate_back(rotation, np.tile(v, (len(time), 1)))) for v in (level, felt)
    )
    reported = Series.of(
        time, iron.raw(reported.values) + np.random.default_rng(1).normal(0.0, 1.0, (len(time), 3))
    )
    compass = replace(track.compasses[1], reported=reported)
    fit = observe_motion(Recorded(replace(track, acc_mps2=acc, compasses={1: compass}), earth=FIELD)).fit
    assert np.diag(fit.gain) == pytest.approx([1.0, 1.0, 1.0], abs=0.05)


def test_the_claim_covers_the_error_as_often_as_it_says() -> None:
    """Twenty vehicles, accelerometers off by 1 mg: the error over the claimed sigma has the spread of 1."""
    ratios = []
    rng = np.random.default_rng(77)
    for seed in range(20):
        iron = iron_of(replace(STRONG, offsets_mgauss=tuple(rng.normal(0.0, 60.0, 3))))
        track = driven(iron, seed=seed, noise=3.0)
        assert track.acc_mps2 is not None
        felt = track.acc_mps2.values + 0.001 * STANDARD_GRAVITY_MPS2 * rng.standard_normal(3)
        track = replace(track, acc_mps2=Series.of(track.acc_mps2.time_s, felt))
        result = calibrate_track(track, "world-field", earth=FIELD)
        assert result.heading_error is not None
        place = int(rng.integers(72))
        sigma = math.degrees(float(result.heading_error.sigma_rad(math.radians(5.0 * place))[0]))
        ratios.append(heading_errors(result.correction, iron)[place] / sigma)
    assert 0.6 < rms(np.array(ratios)) < 1.3


def test_a_gyro_that_reads_a_twelfth_too_little_bends_no_heading() -> None:
    """The heading scatters by 4 degrees against such a gyro: that is the gyro's, and the claim knows it."""
    iron = iron_of(STRONG)
    track = driven(iron, noise=2.0)
    assert track.gyro_radps is not None
    short = Series.of(track.gyro_radps.time_s, track.gyro_radps.values * (1.0 - 1.0 / 12.0))
    result = calibrate_track(replace(track, gyro_radps=short), "world-field", earth=FIELD)
    assert result.accepted, result.reasons
    assert rms(heading_errors(result.correction, iron)) < 2.0 * result.heading_sigma_deg < 2.0
    # A scale of 1 is believed a little.
    assert any(re.search("The gyro reads [567] % less", words) for words in result.warnings)


def test_a_passing_magnet_is_kept_out_and_told() -> None:
    iron = iron_of(STRONG)
    track = driven(iron)
    time = track.compasses[1].time_s
    passing = np.exp(-0.5 * ((time - 20.0) / 0.8) ** 2)[:, np.newaxis] * [90.0, -60.0, 30.0]
    result = calibrate_track(with_field(track, passing), "world-field", earth=FIELD)
    assert result.accepted, result.reasons
    assert rms(heading_errors(result.correction, iron)) < 3.0 * result.heading_sigma_deg + 0.1
    assert any("magnetic passed by" in words for words in result.warnings)


def test_the_motors_field_is_found_where_the_current_swings() -> None:
    iron = iron_of(STRONG)
    track = driven(iron)
    time = track.compasses[1].time_s
    current = 10.0 + 8.0 * np.sin(0.9 * time)
    per_ampere = np.array([3.0, -2.0, 1.0])
    disturbed = replace(
        with_field(track, current[:, np.newaxis] * per_ampere), current_a=Series.of(time, current)
    )
    result = calibrate_track(disturbed, "world-field", earth=FIELD)
    assert result.accepted, result.reasons
    assert result.correction.motor_source == "current"
    undone = np.linalg.solve(result.correction.matrix, -np.asarray(result.correction.motor_mgauss))
    assert np.allclose(undone, per_ampere, atol=0.2)
    assert rms(heading_errors(result.correction, iron)) < 0.5


@pytest.mark.parametrize(
    ("per_ampere", "mean_a", "swing_a", "told"),
    [
        (0.0, 10.0, 8.0, False),  # there is none
        (15.0, 10.0, 8.0, True),
        (3.0, 28.0, 0.3, False),  # it hardly varies: the iron may be it
        (3.0, 28.0, 20.0, True),
    ],
)
def test_motors_are_told_where_the_load_varied_enough(
    per_ampere: float, mean_a: float, swing_a: float, told: bool
) -> None:
    track = driven(iron_of(STRONG))
    time = track.compasses[1].time_s
    current = mean_a + swing_a * np.sin(0.9 * time)
    loaded = with_field(track, current[:, np.newaxis] * [per_ampere, 0.0, 0.0])
    motion = observe_motion(Recorded(replace(loaded, current_a=Series.of(time, current)), 1, FIELD))
    assert motion.load_source == ("current" if told else "none")
    assert (motion.load_doubt_rad > 0.0) is told


def wandering(track: Track, size_mgauss: float) -> Track:
    """Add a field that no rigid compass has, and nothing recorded explains."""
    rng = np.random.default_rng(3)
    time = track.compasses[1].time_s
    knots = np.arange(0.0, time[-1] + 3.0, 3.0)
    added = [np.interp(time, knots, rng.normal(0.0, size_mgauss, knots.size)) for _ in range(3)]
    return with_field(track, np.stack(added, axis=1))


def test_no_result_claims_less_than_the_scatter_it_leaves() -> None:
    result = calibrate_track(wandering(driven(iron_of(STRONG)), 25.0), "world-field", earth=FIELD)
    assert not result.accepted
    assert result.heading_sigma_deg > 3.0
    assert any("scatters by" in reason for reason in result.reasons)


@pytest.mark.parametrize(("stood_s", "kept_out"), [(4.0, True), (25.0, False)])
def test_what_stands_beside_steel_for_long_is_no_exception(stood_s: float, kept_out: bool) -> None:
    """One visit of many it is, but more than a third of the time: then it is in the claim."""
    iron = iron_of(STRONG)
    parked = turning_track(iron, dwell_s=stood_s, turns_deg=())
    time = parked.compasses[1].time_s
    beside = with_field(parked, np.tile([30.0, -30.0, 10.0], (time.size, 1)))
    track = joined([beside.shifted(-float(time[-1]) - 0.02), driven(iron)])
    result = calibrate_track(track, "world-field", earth=FIELD)
    assert (result.heading_sigma_deg < 0.3) == kept_out
    assert kept_out or result.heading_sigma_deg > 1.0


def test_a_beginning_beside_steel_is_cut_off_and_dated() -> None:
    """Longer than something passes by, and shorter than what is called usual."""
    parked, moving = turning_track(STEEL, dwell_s=13.0, turns_deg=()), driven(iron_of(STRONG))
    end_s = float(parked.compasses[1].time_s[-1]) + 0.02
    motion = observe_motion(Recorded(joined([parked.shifted(-end_s), moving]), earth=FIELD))
    later, change = last_stretch(motion)
    assert change is not None and change.is_iron and change.time_s == pytest.approx(0.0, abs=3.0)
    assert later.recorded.track.compasses[1].time_s[0] > -1.0
    assert Change(33.0, 20.0).words().startswith("The iron changed by about 20 mG at 33 s")
    assert Change(33.0, 10.0).words().startswith("What was recorded before 33 s does not fit the rest")


def test_few_headings_do_not_make_a_small_sigma() -> None:
    track = turning_track(iron_of(STRONG), turns_deg=(40.0, 40.0))
    result = calibrate_track(track, "world-field", earth=FIELD)
    assert not result.accepted
    assert any("of the circle" in reason for reason in result.reasons)


def test_a_gain_off_by_a_third_is_called_that() -> None:
    result = calibrate_track(driven(gain_of(0.69)), "world-field", earth=FIELD)
    assert any("gain is off by a third" in words for words in (*result.reasons, *result.warnings))
    refused = calibrate_track(driven(gain_of(0.69)), "four-positions", earth=FIELD)
    assert any("gain is off by a third" in words for words in (*refused.reasons, *refused.warnings))


def test_telemetry_once_a_second_is_called_too_seldom() -> None:
    track = turning_track(iron_of(STRONG), dwell_s=3.0, turn_s=0.8, turns_deg=9 * (110.0,))
    sparse = replace(track, gyro_radps=thinned(track.gyro_radps, 50))
    with pytest.raises(PoorCalibration, match="too seldom to follow the turns"):
        calibrate_track(sparse, "four-positions", earth=FIELD)
    # Length and dip are left to the motion, and they are true.
    whole = calibrate_track(sparse, "world-field", earth=FIELD)
    assert rms(heading_errors(whole.correction, iron_of(STRONG))) < 2.0 * whole.heading_sigma_deg


def test_a_gyro_told_by_threes_at_one_time_is_taken() -> None:
    track = turning_track(iron_of(STRONG), dwell_s=3.0, turn_s=2.0, turns_deg=ROUND)
    gyro = track.gyro_radps
    assert gyro is not None
    at_once = Series.of(np.repeat(gyro.time_s[::3], 3)[: len(gyro)], gyro.values)
    result = calibrate_track(replace(track, gyro_radps=at_once), earth=FIELD)
    assert rms(heading_errors(result.correction, iron_of(STRONG))) < 3.0 * result.heading_sigma_deg


def test_iron_that_changes_is_noticed_and_the_last_stretch_taken() -> None:
    after = iron_of(STRONG)
    track = turning_track(after, dwell_s=2.0, turn_s=2.5, turns_deg=(*ROUND, *ROUND))
    time = track.compasses[1].time_s
    changed = with_field(track, np.where(time < 41.0, 1.0, 0.0)[:, np.newaxis] * [70.0, 40.0, 0.0])
    result = calibrate_track(changed, earth=FIELD)
    assert result.accepted, result.reasons
    assert any("iron changed" in words for words in result.warnings)
    assert rms(heading_errors(result.correction, after)) < 0.3


def test_a_recording_says_by_which_method_it_was_solved() -> None:
    stops = calibrate_track(turning_track(iron_of(STRONG), turns_deg=(90.0,) * 4), earth=FIELD)
    assert stops.method == "four-positions"
    assert any(words.startswith("Method: four-positions") for words in stops.warnings)


def test_a_refusal_names_the_method_that_would_accept() -> None:
    """A compass turned every way without a gyro: no positions, but a full ellipsoid."""
    rng = np.random.default_rng(8)
    direction = rng.normal(0.0, 1.0, (4000, 3))
    field = FIELD.total_mgauss * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    time = np.arange(4000) * 0.05
    compass = MagSeries(1, Series.of(time, iron_of(STRONG).raw(field) + rng.normal(0.0, 1.0, field.shape)))
    track = Track(source="made up", compasses={1: compass})
    with pytest.raises(PoorCalibration):
        calibrate_track(track, "world-field", earth=FIELD)
    assert calibrate_track(track, earth=FIELD).method == "ellipsoid"


def test_one_compass_without_a_solution_does_not_take_the_others_with_it() -> None:
    track = turning_track(iron_of(STRONG))
    still = np.tile(np.array([300.0, 0.0, -400.0]), (len(track.compasses[1].time_s), 1))
    dead = MagSeries(2, Series.of(track.compasses[1].time_s, still))
    found = calibrate_compasses(
        replace(track, compasses={1: track.compasses[1], 2: dead}), "four-positions", earth=FIELD
    )
    assert found[1].accepted
    assert not found[2].accepted and "frozen" in found[2].reasons[0]
    found[2].to_json()


def test_firmware_is_cured_by_its_motion_alone(shared_data: Path) -> None:
    """The exact cure is OFS 120, -80, DIA 1.1, 0.9; stops are not needed for it."""
    track = read_track(shared_data / "ardupilot-4.6.3/rover_dist.BIN")
    result = calibrate_track(track, "world-field")
    exact = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0))
    assert result.accepted, result.reasons
    error = rms(heading_errors(result.correction, iron_of(exact)))
    assert error < 0.4
    assert error < 3.0 * result.heading_sigma_deg
