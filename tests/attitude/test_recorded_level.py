"""Roll and pitch all through recordings: against made motions, and against what others measured."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driven import Way, driven, without

from mavcompass.attitude import down_in_body, levels, moving_average, recorded
from mavcompass.frames import FloatArray, quaternion_to_matrix
from mavcompass.gravity import no_gravity
from mavcompass.heading.doubt import TILT_SIGMA_RAD
from mavcompass.logs.reading import read_track
from mavcompass.track import Series, Track

TIME = np.arange(50.0) * 0.1
DEG = math.radians(1.0)
FORCE = Series.of(TIME, np.tile([0.0, -4.9033, -8.4928], (50, 1)))  # rolled by 30 degrees
NOTHING, UNKNOWN = Series.of([], np.empty((0, 3))), Series.of(TIME, np.full((50, 3), np.nan))
ATTITUDE = Series.of(TIME, np.tile([math.radians(10.0), math.radians(-20.0), 1.0], (50, 1)))
STILL = Series.of(TIME, np.zeros((50, 3)))


@pytest.mark.parametrize(
    ("track", "roll_deg", "pitch_deg"),
    [
        (Track(), 0.0, 0.0),
        (Track(acc_mps2=FORCE), 30.0, 0.0),
        (Track(acc_mps2=FORCE, gyro_radps=STILL), 30.0, 0.0),
        (Track(attitude_rad=ATTITUDE), 10.0, -20.0),
        (Track(acc_mps2=NOTHING, attitude_rad=ATTITUDE, vehicle="rover"), 10.0, -20.0),
        (Track(acc_mps2=UNKNOWN, attitude_rad=ATTITUDE, vehicle="boat"), 10.0, -20.0),
        (Track(acc_mps2=FORCE, attitude_rad=UNKNOWN), 30.0, 0.0),
        (Track(acc_mps2=FORCE, gyro_radps=STILL, attitude_rad=NOTHING), 30.0, 0.0),
    ],
)  # fmt: skip
def test_down_is_told_by_what_there_is(track: Track, roll_deg: float, pitch_deg: float) -> None:
    x, y, z = down_in_body(track, np.array([2.0]))[0]
    assert math.degrees(math.atan2(y, z)) == pytest.approx(roll_deg, abs=0.01)
    assert math.degrees(math.asin(-x)) == pytest.approx(pitch_deg, abs=0.01)
    assert math.hypot(x, y, z) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("bank_deg", "lasting_deg"), [((30.0, 30.0), 0.5), ((30.0, -30.0), 0.0), ((0.0, 0.0), 0.0)]
)
def test_what_lasts_is_the_mean_lean_s_part_of_a_vertical_bias(
    bank_deg: tuple[float, float], lasting_deg: float
) -> None:
    """A bias of 0.2 degrees a second for five seconds, by the sine of 30 degrees to one side all along."""
    roll = np.radians(np.repeat(bank_deg, 25))
    down = Series.of(TIME, np.stack([0.0 * roll, np.sin(roll), np.cos(roll)], axis=1))
    assert recorded.Levels(down, down).lasting_rad / DEG == pytest.approx(lasting_deg, abs=1e-9)


def errors_deg(track: Track, true: FloatArray, own_rad: float = 0.001) -> tuple[float, float]:
    """Return the error of roll and pitch, rms, and the same in sigmas."""
    assert track.gyro_radps is not None
    time, found = track.gyro_radps.time_s, levels(track)
    off2 = ((found.at(time) - true) ** 2).sum(axis=1) / 2.0
    # An accelerometer's own error, as it is mounted, counts beside what motion hides.
    sigma = np.hypot(found.sigma_rad.at(time), own_rad)
    usable = np.isfinite(off2)
    return (float(np.sqrt(off2[usable].mean())) / DEG, float(np.sqrt((off2 / sigma**2)[usable].mean())))


@pytest.mark.parametrize("way", ["circle", "weave", "hard", "stand"])
@pytest.mark.parametrize("gone", [(), ("attitude_rad",), ("receiver_velocity_mps",)], ids="+".join)
def test_what_drives_is_level_whatever_its_bends_push(way: Way, gone: tuple[str, ...]) -> None:
    """Two drives: the error of roll and pitch, and that sigma covers it."""
    found = []
    for seed in range(2):
        track, true = driven(way, seed)
        found.append(errors_deg(without(track, *gone), true))
    rms, sigmas = np.sqrt(np.mean(np.square(found), axis=0))
    felt = math.degrees(1.05 / 9.81) if way != "stand" else 0.0
    assert rms < (0.3 if "receiver_velocity_mps" not in gone else max(0.2 * felt, 0.2))
    # A circle that never ends looks like a gyro's bias: two of its sigmas.
    assert 0.2 < sigmas < (2.0 if way == "circle" else 1.6)


@pytest.mark.parametrize("bent_deg", [0.0, 30.0])
def test_an_autopilot_whose_yaw_is_bent_leads_nobody_astray(bent_deg: float) -> None:
    track, true = driven("weave", 3, bent_deg=bent_deg)
    rms, sigmas = errors_deg(track, true)
    assert rms < 0.2 and sigmas < 1.6


@pytest.mark.parametrize("gone", [(), ("attitude_rad",), ("receiver_velocity_mps",)], ids="+".join)
@pytest.mark.parametrize("way", ["hover", "weave"])
def test_what_flies_leans_as_it_pushes_and_is_level_all_the_same(way: Way, gone: tuple[str, ...]) -> None:
    found = [
        errors_deg(without(t, *gone), d) for t, d in (driven(way, s, vehicle="copter") for s in range(2))
    ]
    rms, sigmas = np.sqrt(np.mean(np.square(found), axis=0))
    assert rms < (0.3 if "receiver_velocity_mps" not in gone else 1.5) and 0.2 < sigmas < 1.8


def test_a_gap_is_not_bridged_and_no_reading_is_needed_twice() -> None:
    track, true = driven("weave", 1)
    assert track.gyro_radps is not None and track.acc_mps2 is not None
    time = track.gyro_radps.time_s
    kept = (time < 40.0) | (time > 55.0)
    cut = Track(
        vehicle="rover",
        acc_mps2=Series.of(time[kept], track.acc_mps2.values[kept]),
        gyro_radps=Series.of(time[kept], track.gyro_radps.values[kept]),
        receiver_velocity_mps=track.receiver_velocity_mps,
    )
    rms, sigmas = errors_deg(cut, true[kept])
    # Beginning anew in a bend, the first reading taken for gravity is off by six degrees.
    assert rms < 0.5 and sigmas < 2.2
    assert levels(cut) is levels(cut)


def test_of_what_has_grown_the_same_is_told_as_if_it_were_new() -> None:
    """A live session asks again and again; the way ahead goes on from where it was."""
    track, _ = driven("weave", 1, seconds=30.0)
    for end_s in (8.0, 8.3, 12.0, 29.0):
        asked_before = levels(track.between(0.0, end_s))
        recorded._runs.clear()
        anew = levels(track.between(0.0, end_s))
        np.testing.assert_array_equal(asked_before.down.values, anew.down.values)
        np.testing.assert_array_equal(asked_before.sigma_rad.values, anew.sigma_rad.values)
    late = track.between(0.0, 29.0)  # a velocity that came late is not left out
    assert late.receiver_velocity_mps is not None
    without_some = replace(late, receiver_velocity_mps=late.receiver_velocity_mps.between(0.0, 20.0))
    recorded._runs.clear()
    alone = levels(without_some).down.values
    levels(late)
    np.testing.assert_array_equal(levels(replace(without_some)).down.values, alone)


def test_shaking_averages_out_of_down_over_six_tenths_of_a_second() -> None:
    force = np.tile([0.0, 0.0, -9.8], (50, 1))
    force[20, 0] = -7.0
    down = down_in_body(Track(acc_mps2=Series.of(TIME, force)), TIME)
    assert down[20, 0] == pytest.approx(7.0 / 9.8 / 6.5, rel=0.1)  # one of six or seven readings
    assert (down[:, 0] > 0.0).sum() in (6, 7)


def test_a_moving_average_is_of_what_is_near_in_time() -> None:
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.25, 5.5])
    values = np.array([[1.0, 0.0], [2.0, 0.0], [6.0, 3.0], [0.0, 1.0], [3.0, 1.0], [9.0, 1.0]])
    mean = moving_average(time, values, 0.5)
    assert mean[:, 0].tolist() == [3.0, 3.0, 3.0, 1.5, 4.0, 6.0] and mean[:, 1].tolist() == [1.0] * 6


@pytest.mark.parametrize(
    ("name", "most_deg"),
    [
        ("real/broad/01_undisturbed_slow_rotation_A.csv", 0.8),
        ("real/broad/28_disturbed_stationary_magnet_A.csv", 2.5),
        ("real/broad/34_disturbed_attached_magnet_3cm.csv", 1.0),
        ("ardupilot-4.6.3/rover_dist.tlog", 0.2),
        ("ardupilot-4.6.3/rover_dist.BIN", 0.2),
        ("ardupilot-4.6.3/copter_dist_use2.tlog", 0.2),
    ],
)  # fmt: skip
def test_what_cameras_and_a_simulator_saw_is_within_its_sigma(
    name: str, most_deg: float, shared_data: Path
) -> None:
    """What nobody here made: a hand that turns a box before cameras, and firmware that drives and hovers."""
    track = read_track(shared_data / name)
    true = track.reference_q or track.truth_q
    assert true is not None and track.gyro_radps is not None
    q = np.asarray(true.at(track.gyro_radps.time_s))
    down = quaternion_to_matrix(q / np.linalg.norm(q, axis=1, keepdims=True))[:, 2, :]
    rms, sigmas = errors_deg(without(track, "reference_q"), down, TILT_SIGMA_RAD)
    assert rms < most_deg and sigmas < 1.4


@pytest.mark.parametrize("gyro", [None, STILL], ids=["no gyro", "gyro"])
@pytest.mark.parametrize("attitude", [None, ATTITUDE], ids=["no attitude", "attitude"])
@pytest.mark.parametrize("share", [0.0, 0.102, 32.8], ids=["dead", "in g", "at its end"])
def test_an_accelerometer_without_gravity_tells_no_level(
    share: float, attitude: Series | None, gyro: Series | None
) -> None:
    force = Series.of(TIME, share * np.asarray(FORCE.values))
    found = levels(Track(acc_mps2=force, gyro_radps=gyro, attitude_rad=attitude))
    assert float(found.sigma_rad.at(TIME).max()) > 15.0 * DEG
    assert ("not recorded" in no_gravity(force), "nothing tells" in no_gravity(force)) == (not share, True)
    assert not no_gravity(FORCE) and not no_gravity(None) and not no_gravity(UNKNOWN)
