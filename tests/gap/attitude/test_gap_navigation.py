"""The smoothed attitude against the true one of vehicles that another generator draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.frames import FloatArray, euler_to_matrix, quaternion_to_matrix, rotate_back
from mavcompass.gap.attitude.kinematics import integral
from mavcompass.gap.attitude.reference import Reference, body_rate, reference_attitude
from mavcompass.gap.attitude.sensors import white_floor
from mavcompass.gap.attitude.smoother import remembered_turns
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# All flights of less than 75 s among the first forty: every kind of vehicle, motion, receiver and steering.
SEEDS = (1, 2, 3, 4, 8, 11, 12, 23, 26, 28, 30, 31, 32, 34, 39)


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Hold a flight whose own compass, if it steers the autopilot, steers it wrongly; and what was found."""

    track: Track
    truth: FloatArray
    own: bool
    found: Reference


def times_of(track: Track) -> FloatArray:
    assert track.truth_q is not None
    return track.truth_q.time_s


def truth_of(track: Track) -> FloatArray:
    assert track.truth_q is not None
    return quaternion_to_matrix(track.truth_q.values)


def autopilots(track: Track) -> FloatArray:
    assert track.attitude_rad is not None
    return euler_to_matrix(*track.attitude_rad.values.T)


def misled(track: Track) -> Track:
    """Turn the autopilot's yaw by 20 degrees, and bend it with the heading as a compass's iron does."""
    assert track.attitude_rad is not None
    angles = track.attitude_rad.values.copy()
    angles[:, 2] += math.radians(20.0) + math.radians(8.0) * np.sin(angles[:, 2] + 1.0)
    return replace(track, attitude_rad=Series.of(track.attitude_rad.time_s, angles))


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    found = []
    for seed in SEEDS:
        case = make_case(seed, "none", baseline=False)
        own = case.vehicle is not None and case.vehicle.steering == "this_compass"
        track = misled(case.track) if own else case.track
        found.append(Flight(track, truth_of(track), own, reference_attitude(track, times_of(track))))
    return found


def tilt_off(rotation: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the small rotations about the world's level axes from an attitude to the true one, (N, 2)."""
    down = np.cross(rotation[:, 2], truth[:, 2])
    return np.asarray(-np.einsum("nij,nj->ni", rotation, down)[:, :2])


def yaw_off(rotation: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the rotations about the vertical from an attitude to the true one, (N,)."""
    e = np.einsum("nij,nkj->nik", truth, rotation)
    return np.arctan2(e[:, 1, 0] - e[:, 0, 1], e[:, 0, 0] + e[:, 1, 1])


def mean_angle(angles: FloatArray) -> float:
    return float(np.angle(np.exp(1j * angles).mean()))


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def stated(found: Reference) -> FloatArray:
    """Return the standard deviations about the world's axes that the curves state, (N, 3)."""
    return np.sqrt((found.curves_rad**2).sum(axis=2))


def test_smoothed_level_is_better_than_the_autopilots(flights: list[Flight]) -> None:
    better = [
        rms(tilt_off(f.found.rotation, f.truth)) < rms(tilt_off(autopilots(f.track), f.truth))
        for f in flights
    ]
    assert np.mean(better) >= 0.8


def test_stated_doubt_of_the_level_covers_its_errors(flights: list[Flight]) -> None:
    inside = [np.abs(tilt_off(f.found.rotation, f.truth)) < stated(f.found)[:, :2] for f in flights]
    assert 0.60 < np.mean([np.mean(one) for one in inside]) < 0.90


def by_the_receiver_alone(flights: list[Flight]) -> Iterator[Flight]:
    return (f for f in flights if f.own and not f.found.yaw_unknown)


def test_receiver_tells_the_yaw_although_the_compass_misleads_the_autopilot(flights: list[Flight]) -> None:
    told = list(by_the_receiver_alone(flights))
    assert len(told) >= 5
    for flight in told:
        off = abs(mean_angle(yaw_off(flight.found.rotation, flight.truth)))
        assert off < 3.0 * flight.found.yaw_sigma_rad and off < math.radians(3.0)
        assert abs(mean_angle(yaw_off(autopilots(flight.track), flight.truth))) > math.radians(8.0)


def test_yaw_that_only_the_compass_under_test_tells_is_unknown(flights: list[Flight]) -> None:
    silent = [f for f in flights if f.own and "receiver" not in f.found.notes[0]]
    assert silent and all(f.found.yaw_unknown for f in silent)


def test_yaw_of_another_source_is_known(flights: list[Flight]) -> None:
    for flight in flights:
        if not flight.own:
            off = abs(mean_angle(yaw_off(flight.found.rotation, flight.truth)))
            assert not flight.found.yaw_unknown and off < 3.0 * flight.found.yaw_sigma_rad


BIAS = np.array([0.02, -0.03, 0.04])
# An axis whose bias the recording tells, rad/s: what was supposed beforehand has little weight in it.
TOLD_RADPS = 5.5e-4


@pytest.mark.parametrize("begins_deg", [-6.0, 6.0])
def test_a_filter_that_has_just_begun_bends_no_yaw(flights: list[Flight], begins_deg: float) -> None:
    """Its first yaw is that of one reading, and it needs seconds to come from there."""
    tried = 0
    for flight in (f for f in flights if not f.own):
        attitude = flight.track.attitude_rad
        assert attitude is not None
        angles = attitude.values.copy()
        since_s = attitude.time_s - attitude.time_s[0]
        angles[:, 2] += math.radians(begins_deg) * np.exp(-since_s / 6.0)
        begun = replace(flight.track, attitude_rad=Series.of(attitude.time_s, angles))
        found = reference_attitude(begun, times_of(begun))
        wander = [np.degrees(yaw_off(r.rotation, flight.truth)) for r in (flight.found, found)]
        assert np.std(wander[1]) < np.std(wander[0]) + 0.25
        tried += 1
    assert tried >= 4


def with_bias(track: Track, bias: FloatArray) -> tuple[Track, FloatArray]:
    """Return a track whose gyro has a bias more, and all that it says beyond the true rate, (3,)."""
    assert track.gyro_radps is not None
    gyro = Series.of(track.gyro_radps.time_s, track.gyro_radps.values + bias)
    when = times_of(track)
    beyond = gyro.at(when) - body_rate(when, truth_of(track))
    return replace(track, gyro_radps=gyro), np.asarray(np.median(beyond, axis=0))


@pytest.mark.parametrize(("seed", "axes"), [(3, 2), (30, 3), (34, 3)])
def test_large_bias_of_the_gyro_is_found_on_the_axes_that_the_motion_tells(seed: int, axes: int) -> None:
    track, true = with_bias(make_case(seed, "none", baseline=False).track, BIAS)
    found = reference_attitude(track, times_of(track)).errors["gyro offset"]
    told = found.sigma < TOLD_RADPS
    assert told.sum() == axes
    assert (np.abs(found.mean - true) < 0.1 * np.abs(BIAS))[told].all()
    assert (np.abs(found.mean - true) < 3.0 * found.sigma)[told].all()


def test_the_doubt_in_a_usual_bias_of_the_gyro_covers_it() -> None:
    off = []
    for seed in range(1, 9):
        track, true = with_bias(make_case(seed, "none", baseline=False).track, 0.1 * BIAS)
        found = reference_attitude(track, times_of(track)).errors["gyro offset"]
        assert (found.sigma < math.radians(0.2)).all()
        off.append(np.abs(found.mean - true) / found.sigma)
    assert np.mean(np.array(off) < 1.0) > 0.68 and np.mean(np.array(off) < 3.0) > 0.95


def test_a_receiver_that_what_is_felt_contradicts_tells_no_yaw() -> None:
    # Turned by hand on one spot: what is felt and a receiver's noise go together by chance.
    track = make_case(56597, "none").baseline
    assert track is not None
    found = reference_attitude(track, times_of(track))
    assert found.yaw_unknown and "receiver" not in found.notes[0]


@given(st.floats(0.02, 0.48), st.floats(0.0, 30.0))
@settings(max_examples=20, deadline=None)
def test_floor_of_a_spectrum_is_no_rocking_at_any_frequency(share_of_rate: float, size: float) -> None:
    """A rover rocks at four hertz, and is recorded at twelve."""
    rng = np.random.default_rng(6)
    phase = 2.0 * np.pi * share_of_rate * np.arange(3000)
    values = rng.standard_normal((3000, 2)) * [0.2, 1.0] + size * np.sin(phase)[:, None]
    assert white_floor(values) == pytest.approx([0.2, 1.0], rel=0.1, abs=0.01 * size)


def test_what_rocks_about_one_axis_makes_no_other_doubtful() -> None:
    rng, step = np.random.default_rng(7), 0.08
    t = np.arange(0.0, 200.0, step)
    rocking = 0.2 * np.sin(2.0 * np.pi * 4.0 * t + np.cumsum(rng.normal(0.0, 0.05, t.size)))
    rate = rng.normal(0.0, 0.004, (t.size, 3))
    rate[:, 0] += rocking
    force = np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (t.size, 1)) + rng.normal(0.0, 0.1, (t.size, 3))
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, np.tile([200.0, 0.0, 400.0], (t.size, 1))))},
        gyro_radps=Series.of(t, rate),
        acc_mps2=Series.of(t, force),
    )
    curves = reference_attitude(track, t).curves_rad
    within_deg = np.degrees(np.median(np.sqrt(((curves[12:] - curves[:-12]) ** 2).sum(axis=2)), axis=0))
    # The gyro's own noise, 0.004 rad/s every 0.08 s, is 0.065 degrees within a second.
    assert within_deg[1] < 0.065
    assert within_deg[2] < 0.065 * 3.0


def without(series: Series | None, silent: Callable[[FloatArray], FloatArray]) -> Series | None:
    if series is None:
        return None
    heard = ~silent(series.time_s)
    return Series.of(series.time_s[heard], series.values[heard])


@pytest.mark.parametrize("seed", [3, 12, 31])
def test_attitude_carries_on_after_a_second_without_readings(flights: list[Flight], seed: int) -> None:
    flight = flights[SEEDS.index(seed)]
    track, truth, whole = flight.track, flight.truth, flight.found
    when = times_of(track)
    begin = float(when[0]) + 0.5 * float(when[-1] - when[0])

    def silent(t: FloatArray) -> FloatArray:
        return (t > begin) & (t < begin + 1.0)

    lost = replace(
        track,
        gyro_radps=without(track.gyro_radps, silent),
        acc_mps2=without(track.acc_mps2, silent),
        attitude_rad=without(track.attitude_rad, silent),
    )
    found = reference_attitude(lost, when)
    missing = (when > begin + 0.3) & (when < begin + 0.7)
    assert not found.known[missing].any() and whole.known[missing].all()
    after = (when > begin + 1.0) & (when < begin + 6.0)
    yaw = yaw_off(found.rotation, truth)
    level = tilt_off(found.rotation, truth)
    sigma = np.hypot(stated(found), found.tilt_sigma_rad)
    assert rms(level[after] / sigma[after, :2]) < 2.0
    assert rms(yaw[after] / np.hypot(sigma[after, 2], found.yaw_sigma_rad)) < 2.0
    # One second tells little of the yaw: its doubt stays.
    assert found.yaw_sigma_rad < 2.0 * whole.yaw_sigma_rad + math.radians(0.2)


@pytest.mark.parametrize("seed", range(3))
def test_receiver_of_what_stands_and_turns_tells_no_yaw(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    t = np.arange(0.0, 60.0, 0.04)
    rotation = euler_to_matrix(0.05 * np.sin(0.5 * t), 0.04 * np.sin(0.4 * t), 0.6 * np.sin(0.3 * t) + 1.0)
    force = rotate_back(rotation, np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (t.size, 1)))
    heard = t[::5]
    # Slow errors of some tenths of a metre a second, as a receiver has them near walls.
    slow = np.stack([np.convolve(rng.normal(size=heard.size), np.ones(8) / 8.0, "same") for _ in "xyz"], 1)
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, rotate_back(rotation, np.array([200.0, 0.0, 400.0]))))},
        gyro_radps=Series.of(t, body_rate(t, rotation) + rng.normal(0.0, 0.002, (t.size, 3))),
        acc_mps2=Series.of(t, force + rng.normal(0.0, 0.05, force.shape)),
        gps_velocity_mps=Series.of(heard, slow + rng.normal(0.0, 0.05, slow.shape)),
    )
    found = reference_attitude(track, t)
    assert found.yaw_unknown
    assert rms(tilt_off(found.rotation, rotation)) < math.radians(0.3)


@pytest.mark.parametrize("seed", range(3))
def test_autopilot_tells_how_far_it_turned_while_nothing_was_heard(seed: int) -> None:
    """Four positions: the gyro says little of a turn that is lost with the telemetry."""
    rng = np.random.default_rng([seed, 6])
    t = np.arange(0.0, 240.0, 0.04)
    yaw = math.radians(90.0) * np.sum(
        [np.clip((t - s) / 3.0, 0.0, 1.0) for s in (50.0, 110.0, 170.0)], axis=0
    )
    rotation = euler_to_matrix(0.05 * np.sin(0.5 * t), 0.04 * np.sin(0.4 * t), yaw)
    force = rotate_back(rotation, np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (t.size, 1)))
    # The compass that steers is bent by as much as a calibration leaves.
    told = np.stack([0.05 * np.sin(0.5 * t), 0.04 * np.sin(0.4 * t), yaw + 0.03 * np.sin(yaw)], axis=1)
    heard = (t < 49.8) | (t > 53.3)
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, rotate_back(rotation, np.array([200.0, 0.0, 400.0]))))},
        gyro_radps=Series.of(t[heard], (body_rate(t, rotation) + rng.normal(0.0, 0.002, (t.size, 3)))[heard]),
        acc_mps2=Series.of(t[heard], (force + rng.normal(0.0, 0.05, force.shape))[heard]),
        attitude_rad=Series.of(t[heard], told[heard]),
    )
    found = reference_attitude(track, t)
    off = np.degrees(np.unwrap(yaw_off(found.rotation, rotation)))
    jump = np.mean(off[(t > 53.3) & (t < 57.0)]) - np.mean(off[(t > 46.0) & (t < 49.8)])
    assert abs(jump) < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_what_the_level_errs_by_within_seconds_is_told(seed: int) -> None:
    """A tenth of a degree that comes and goes with the accelerometer's scatter: a milligauss of the field."""
    rng = np.random.default_rng([seed, 9])
    t = np.arange(0.0, 600.0, 0.1)
    yaw = integral(t, (0.4 * np.sin(0.21 * t) + 0.3 * np.sin(0.093 * t + 1.0))[:, None])[:, 0]
    roll, pitch = 0.1 * np.sin(0.5 * t), 0.08 * np.sin(0.4 * t)
    rotation = euler_to_matrix(roll, pitch, yaw)
    force = rotate_back(rotation, np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (t.size, 1)))
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, rotate_back(rotation, np.array([200.0, 0.0, 400.0]))))},
        gyro_radps=Series.of(t, body_rate(t, rotation) + rng.normal(0.0, 0.004, (t.size, 3))),
        acc_mps2=Series.of(t, force + rng.normal(0.0, 0.1, force.shape)),
        attitude_rad=Series.of(t, np.stack([roll, pitch, yaw + 0.03 * np.sin(yaw)], axis=1)),
        parameters={"COMPASS_USE": 0.0, "COMPASS_USE2": 1.0},
    )
    # Told at every seventh reading, as at all of them.
    found, some = reference_attitude(track, t), slice(3, None, 7)
    thinned = reference_attitude(track, t, doubted=some).thinned()
    np.testing.assert_allclose(thinned.rotation, found.rotation[some])
    np.testing.assert_allclose((thinned.curves_rad**2).sum(axis=2), stated(found)[some] ** 2, atol=1e-12)
    off = tilt_off(found.rotation, rotation)
    assert 0.6 < rms(off) / rms(stated(found)[:, :2]) < 1.4


@pytest.mark.parametrize("forgets_s", [2.5, 6.0, 20.0])
@pytest.mark.parametrize("scale_off", [-0.004, 0.006])
def test_autopilot_that_integrates_the_same_gyro_does_not_bear_its_scale_out(
    forgets_s: float, scale_off: float
) -> None:
    """To and fro on the spot, ten seconds each way: its yaw goes with the gyro, and is pulled back slowly by
    a compass that is late."""
    rng, step, late_s = np.random.default_rng(8), 0.04, 0.02
    t = np.arange(0.0, 240.0, step)
    speed = np.repeat([0.8, 0.0, -0.8, 0.0], [250, 50, 250, 50])
    rate = np.convolve(np.resize(speed, t.size), np.ones(20) / 20.0, "same")
    yaw = np.cumsum(rate) * step
    rotation = euler_to_matrix(np.zeros(t.size), np.zeros(t.size), yaw)
    off = np.zeros(t.size)
    for k in range(1, t.size):
        pulled = off[k - 1] + late_s * rate[k - 1]
        off[k] = off[k - 1] + step * (scale_off * rate[k - 1] - pulled / forgets_s)
    gyro = np.stack([0.0 * t, 0.0 * t, (1.0 + scale_off) * rate], axis=1)
    force = np.tile([0.0, 0.0, -STANDARD_GRAVITY_MPS2], (t.size, 1))
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, rotate_back(rotation, np.array([200.0, 0.0, 400.0]))))},
        gyro_radps=Series.of(t, gyro + rng.normal(0.0, 0.002, gyro.shape)),
        acc_mps2=Series.of(t, force + rng.normal(0.0, 0.05, force.shape)),
        attitude_rad=Series.of(t, np.stack([0.0 * t, 0.0 * t, yaw + off], axis=1)),
        parameters={"COMPASS_USE": 0.0, "COMPASS_USE2": 1.0},
    )
    found = reference_attitude(track, t)
    assert found.witnessed
    error = yaw_off(found.rotation, rotation)
    # How old the gyro is beside the autopilot is told to a hundredth of a second.
    known = np.stack([np.ones(t.size), rate], axis=1)
    error -= known @ np.linalg.lstsq(known, error, rcond=None)[0]
    # What is left of it beside the curves, each within what is stated.
    curves = found.curves_rad[:, 2] - found.curves_rad[:, 2].mean(axis=0)
    sigma = math.radians(0.1)
    design = np.vstack([curves / sigma, np.eye(curves.shape[1])])
    wanted = np.concatenate([error / sigma, np.zeros(curves.shape[1])])
    amplitudes = np.linalg.lstsq(design, wanted, rcond=None)[0]
    assert rms(error - curves @ amplitudes) < math.radians(0.2)
    assert np.abs(amplitudes).max() < 3.5


def test_yaw_of_a_circling_vehicle_that_is_off_takes_its_level_along() -> None:
    """A yaw that is off by c turns an acceleration a to the left into c a ahead, which is a pitch of c a / g:
    left and right in turn it changes sides, but for what the gyro knows better."""
    rng, step, speed = np.random.default_rng(8), 0.05, 5.0
    t = np.arange(0.0, 240.0, step)
    rate = np.convolve(np.resize(np.repeat([0.6, -0.6], 1000), t.size), np.ones(20) / 20.0, "same")
    yaw = integral(t, rate[:, None])[:, 0]
    rotation = euler_to_matrix(np.zeros(t.size), np.zeros(t.size), yaw)
    velocity = speed * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1)
    pushed = np.gradient(velocity, step, axis=0) - [0.0, 0.0, STANDARD_GRAVITY_MPS2]
    gyro = np.stack([0.0 * t, 0.0 * t, rate], axis=1) + rng.normal(0.0, 0.02, (t.size, 3))
    force = rotate_back(rotation, pushed) + rng.normal(0.0, 0.1, (t.size, 3))
    track = Track(
        compasses={1: MagSeries(1, Series.of(t, rotate_back(rotation, np.array([200.0, 0.0, 400.0]))))},
        gyro_radps=Series.of(t, gyro),
        acc_mps2=Series.of(t, force),
        gps_velocity_mps=Series.of(t[::4], velocity[::4] + rng.normal(0.0, 0.1, (len(t[::4]), 3))),
    )
    found = reference_attitude(track, t)
    pitch = rotate_back(rotation, found.with_yaw)[:, 1]
    whole = 0.6 * speed / STANDARD_GRAVITY_MPS2
    for side in (-1.0, 1.0):
        even = (rate * side > 0.59) & (t > 20.0) & (t < 220.0)
        assert -1.0 < side * pitch[even].mean() / whole < -0.8
    assert abs(found.with_yaw[:, 2].mean()) < 0.02


def test_turn_is_remembered_as_long_as_a_filter_remembers() -> None:
    """Of an even turn e' = w - e / T makes w T (1 - exp(-t / T)); after it exp(-t / T) of that is left."""
    t = np.arange(0.0, 60.0, 0.05)
    remembered = remembered_turns(t, 0.3 * np.minimum(t, 20.0))
    memories = np.array([2.0, 8.0, 32.0])
    grown = 0.3 * memories * (1.0 - np.exp(-np.minimum(t, 20.0)[:, None] / memories))
    fading = np.exp(-np.maximum(t - 20.0, 0.0)[:, None] / memories)
    np.testing.assert_allclose(remembered, grown * fading, atol=2e-5)
