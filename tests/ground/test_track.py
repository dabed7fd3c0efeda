"""Track: columns on their own clocks, and the readings with the corrections in force undone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.messages import (
    Attitude,
    GlobalPositionInt,
    GpsRawInt,
    Incoming,
    Message,
    ParamValue,
    RawImu,
    ScaledImu,
    ScaledImu2,
    SysStatus,
    SystemTime,
)
from mavcompass.saturation import may_saturate, saturated
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.track_builder import TrackBuilder, with_sound_times


def test_a_series_interpolates_and_holds_its_ends() -> None:
    series = Series.of([1.0, 2.0, 4.0], [[0.0, 10.0], [1.0, 20.0], [3.0, 0.0]])
    assert series.at([0.0, 1.5, 3.0, 9.0]) == pytest.approx(
        np.array([[0.0, 10.0], [0.5, 15.0], [2.0, 10.0], [3.0, 0.0]])
    )
    assert np.isnan(Series.of([], []).at([1.0])).all()
    assert series.at(series.time_s) is series.values


def test_columns_of_a_series_lie_contiguous() -> None:
    values = Series.of(np.arange(5.0), np.arange(15.0).reshape(5, 3)).values
    assert all(values[:, axis].flags["C_CONTIGUOUS"] for axis in range(3))


def test_times_and_values_of_different_length_are_refused() -> None:
    with pytest.raises(ValueError, match="do not go with"):
        Series.of([0.0, 1.0], [1.0])


def test_raw_field_honours_a_correction_that_changed_in_mid_recording() -> None:
    raw = np.tile([100.0, 200.0, 300.0], (6, 1))
    old, new = FieldCorrection((5.0, 13.0, -18.0)), FieldCorrection((50.0, 0.0, 0.0), (1.1, 0.9, 1.0))
    reported = np.concatenate([old.apply(raw[:3]), new.apply(raw[3:])])
    compass = MagSeries(1, Series.of(np.arange(6.0), reported), (InForce(-np.inf, old), InForce(2.5, new)))
    assert Track(compasses={1: compass}).raw_field(1) == pytest.approx(raw)


def test_raw_field_takes_the_motor_term_out_at_the_current_of_the_time() -> None:
    correction = FieldCorrection(motor_mgauss=(2.0, 0.0, -1.0), motor_source="current")
    times = np.arange(4.0)
    current = Series.of([0.0, 3.0], [0.0, 30.0])
    raw = np.tile([100.0, 200.0, 300.0], (4, 1))
    compass = MagSeries(
        1, Series.of(times, correction.apply(raw, current.at(times))), (InForce(0.0, correction),)
    )
    assert Track(compasses={1: compass}, current_a=current).raw_field(1) == pytest.approx(raw)


def test_cutting_a_track_cuts_every_column() -> None:
    track = Track(
        compasses={2: MagSeries(2, Series.of(np.arange(10.0), np.zeros((10, 3))))},
        gyro_radps=Series.of(np.arange(10.0), np.zeros((10, 3))),
        current_a=Series.of(np.arange(0.0, 10.0, 2.0), np.ones(5)),
    )
    cut = track.between(2.0, 6.0)
    assert cut.compasses[2].time_s.tolist() == [2.0, 3.0, 4.0, 5.0]
    assert cut.gyro_radps is not None and len(cut.gyro_radps) == 4
    assert cut.current_a is not None and cut.current_a.time_s.tolist() == [2.0, 4.0]
    assert cut.duration_s == 3.0


def heard(time_s: float, message: Message) -> Incoming:
    return Incoming(time_s, 1, 1, message)


def test_a_live_stream_becomes_a_track_in_the_vehicles_time() -> None:
    builder = TrackBuilder("ardupilot", "rover")
    builder.set_correction(1, FieldCorrection((10.0, 0.0, 0.0)))
    for i in range(10):
        boot = 100.0 + 0.1 * i
        builder.add(heard(5.0 + 0.1 * i, RawImu(time_usec=int(boot * 1e6), zacc=-1000, xgyro=100, xmag=250)))
    builder.add(heard(5.5, SysStatus(current_battery=1250)))
    builder.add(heard(5.5, Attitude(time_boot_ms=100_500, yaw=1.0)))
    builder.add(heard(5.6, GlobalPositionInt(100_600, lat=471234567, lon=85000000, alt=450_000)))
    builder.add(heard(5.6, SystemTime(1_790_000_000_000_000, 100_600)))
    builder.add(heard(5.6, ParamValue("COMPASS_OFS_X", 10.0)))
    track = builder.build()
    assert track.compasses[1].time_s == pytest.approx(100.0 + 0.1 * np.arange(10))
    assert track.raw_field(1)[0] == pytest.approx([240.0, 0.0, 0.0])
    assert track.acc_mps2 is not None and track.acc_mps2.values[0] == pytest.approx([0.0, 0.0, -9.80665])
    assert track.gyro_radps is not None and track.gyro_radps.values[0] == pytest.approx([0.1, 0.0, 0.0])
    assert track.current_a is not None and track.current_a.values == pytest.approx([12.5])
    assert track.current_a.time_s == pytest.approx([100.5])
    assert track.place is not None and track.place.values[0] == pytest.approx([47.1234567, 8.5, 450.0])
    assert track.utc_offset_s == pytest.approx(1_790_000_000.0 - 100.6)
    assert track.parameters["COMPASS_OFS_X"] == 10.0


def test_the_receivers_velocity_is_known_over_ground_only() -> None:
    builder = TrackBuilder("ardupilot", "copter")
    builder.add(heard(5.0, Attitude(time_boot_ms=100_000)))
    fixed = GpsRawInt(100_200_000, 3, vel=500, cog=9_000)
    for message in (fixed, GpsRawInt(100_400_000, 2, vel=500, cog=9_000), GpsRawInt(100_600_000, 3, vel=500)):
        builder.add(heard(5.2, message))  # one without a fix, one without a course
    velocity = builder.build().gps_velocity_mps
    assert velocity is not None and velocity.time_s == pytest.approx([100.2])
    np.testing.assert_allclose(velocity.values, [[0.0, 5.0, np.nan]], atol=1e-9)


def test_late_and_repeated_messages_are_put_in_order() -> None:
    builder = TrackBuilder()
    for boot_us in (0, 100_000, 300_000, 200_000, 200_000, 400_000):
        builder.add(heard(boot_us * 1e-6, RawImu(time_usec=boot_us, xmag=boot_us // 1000)))
    compass = builder.build().compasses[1]
    assert compass.time_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert compass.reported.values[:, 0].tolist() == [0.0, 100.0, 200.0, 300.0, 400.0]


def test_a_restart_of_the_autopilot_starts_the_track_anew() -> None:
    builder = TrackBuilder()
    for boot_s in (100.0, 101.0, 102.0, 0.5, 1.5):
        builder.add(heard(0.0, RawImu(time_usec=int(boot_s * 1e6))))
    assert builder.restarts == 1
    assert builder.build().compasses[1].time_s == pytest.approx([0.5, 1.5])


def test_the_denser_message_speaks_for_the_first_compass() -> None:
    builder = TrackBuilder()
    for i in range(4):
        builder.add(heard(i, ScaledImu(time_boot_ms=1000 * i, xmag=1)))
        builder.add(heard(i, ScaledImu2(time_boot_ms=1000 * i, xmag=2)))
    builder.add(heard(1.0, RawImu(time_usec=1_000_000, xmag=3)))
    track = builder.build()
    assert track.compasses[1].reported.values[:, 0].tolist() == [1.0] * 4
    assert track.compasses[2].reported.values[:, 0].tolist() == [2.0] * 4


def test_a_flood_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavcompass.track_builder._MOST_ROWS", 5)
    builder = TrackBuilder("ardupilot", "rover")
    for k in range(50):
        builder.add(heard(0.1 * k, RawImu(time_usec=100_000 * k, xmag=k)))
    assert builder.build().compasses[1].reported.values[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    builder.take()
    builder.add(heard(5.1, RawImu(time_usec=5_100_000, xmag=51)))
    assert builder.take().compasses[1].reported.values[:, 0].tolist() == [51.0]


@pytest.mark.parametrize("noise", [0.0, 0.15, 0.4, 3.0])
@pytest.mark.parametrize("step", [1.0, 0.01])
def test_what_a_sensor_cuts_off_piles_up_and_a_turns_own_end_does_not(noise: float, step: float) -> None:
    rng = np.random.default_rng(3)
    yaw = np.repeat(np.linspace(0.0, 4.0 * math.pi, 1500), 2)  # each reading told twice
    field = np.stack([220.0 * np.cos(yaw) + 60.0, -220.0 * np.sin(yaw), 0.0 * yaw - 430.2], axis=1)
    whole = np.repeat(np.round((field[::2] + rng.normal(0.0, noise, (1500, 3))) / step) * step, 2, axis=0)
    assert not saturated(whole, step).any()
    assert not saturated(whole[:200], step).any() and not saturated(whole[:1]).any()
    bumps = np.where(rng.random(3000) < 0.05, np.round(rng.uniform(0.0, 9.0, 3000)), 0.0)
    assert not saturated(np.stack([whole[:, 0], whole[:, 1], bumps - 430.0], axis=1), step).any()
    for end in (200.0, 260.0):
        cut = np.minimum(whole, [end, 1e3, 1e3])
        assert (saturated(cut, step) == (cut[:, 0] == end)).all()
    # A limit is one for all axes: what rests may be at it, if nothing is larger.
    aside = whole + np.array([300.0, 0.0, 0.0])
    assert not may_saturate(aside, step) and may_saturate(np.clip(aside, -530.0, 530.0), step)
    assert may_saturate(np.clip(whole, -300.0, 300.0), step)


def test_a_written_correction_moves_the_steps_of_readings_and_no_end_of_the_range() -> None:
    """A hovering copter at five headings, the last after the write: hardly two readings of it are equal."""
    rng, old = np.random.default_rng(3), FieldCorrection((5.0, 13.0, -18.0))
    new = FieldCorrection((-89.0, 187.0, 34.0), (0.990, 0.993, 0.992), (-0.0006, 0.0011, -0.0021))
    yaw = np.repeat(np.arange(5.0), 60) + rng.normal(0.0, 0.02, 300)
    level = np.stack([220.0 * np.cos(yaw), -220.0 * np.sin(yaw), np.full(300, -567.0)], axis=1)
    raw = level + np.array([80.0, -190.0, 0.0]) + rng.normal(0.0, 0.3, (300, 3))
    told = np.trunc(np.concatenate([old.apply(raw[:240]), new.apply(raw[240:])]))
    steps = (InForce(-np.inf, old), InForce(240.0, new))
    compass = MagSeries(1, Series.of(np.arange(300.0), told), steps, quantum_mgauss=1.0, truncated=True)
    assert not Track(compasses={1: compass}).saturated(1).any()


def test_a_limit_is_seen_through_the_rounding_of_what_it_was_corrected_by() -> None:
    rng = np.random.default_rng(4)
    by = FieldCorrection((80.0, -40.0, 20.0), (1.1, 0.95, 1.0), (0.05, -0.03, 0.04))
    yaw = np.linspace(0.0, 9.0, 800)
    field = np.stack([380.0 * np.cos(yaw), -380.0 * np.sin(yaw), 0.0 * yaw + 260.0], axis=1)
    field += rng.normal(0.0, 2.0, field.shape)
    for limit, seen in ((340.0, True), (1e4, False)):
        told = np.round(by.apply(np.clip(field, -limit, limit)))
        compass = MagSeries(1, Series.of(yaw, told), (InForce(-np.inf, by),), quantum_mgauss=1.0)
        assert Track(compasses={1: compass}).may_saturate(1) is seen


# --- A track's clock is one that its samples bear out, whatever time stamps say


HOUR_S = 3600.0


def track(times: np.ndarray, **columns: Series) -> Track:
    field = Series.of(times, np.ones((times.size, 3)))
    steps = (InForce(-np.inf, IDENTITY), InForce(float(times[-1]), FieldCorrection((5.0, 0.0, 0.0))))
    return Track(compasses={1: MagSeries(1, field, steps)}, **columns)  # type: ignore[arg-type]


def test_a_recording_as_they_are_is_left_alone() -> None:
    """An hour between two flights, or a day in which something came every second."""
    for times in (np.r_[0:300:0.1, 3000:3300:0.1], np.arange(86_400.0), np.array([5.0])):
        one = track(times)
        assert with_sound_times(one) is one


@pytest.mark.parametrize("leap_s", [1e4, 1e9, 1e17, 1e300])
@pytest.mark.parametrize("where", [0, 500, 999])
def test_one_time_that_leaps_costs_an_hour_at_most(leap_s: float, where: int) -> None:
    times = 20.0 + 0.1 * np.arange(1000)
    times[where] += leap_s
    sound = with_sound_times(track(np.sort(times)))
    compass = sound.compasses[1]
    span_s = compass.time_s[-1] - compass.time_s[0]
    assert span_s == pytest.approx(HOUR_S)
    # All others are where they were, to the step of such numbers.
    assert np.count_nonzero(np.isin(compass.time_s.round(6), times.round(6))) == 999
    assert compass.in_force[1].from_s == pytest.approx(compass.time_s[-1])
    assert "1 silences were shortened" in sound.notes[-1]


@given(st.lists(st.floats(1.0, 1e9), min_size=2, max_size=40))
def test_silences_are_shortened_to_one_length_as_far_as_it_takes(silences: list[float]) -> None:
    times = np.concatenate([[0.0], np.cumsum(silences)])
    kept = np.diff(with_sound_times(track(times)).compasses[1].time_s)
    step = 1e-3  # of numbers as large as these, with room
    assert kept.sum() <= HOUR_S + step
    shortened = kept < np.diff(times) - step
    if times[-1] > HOUR_S + 40 * step:
        assert shortened.any() and kept.sum() == pytest.approx(HOUR_S)
        assert np.ptp(kept[shortened]) < step and kept.max() < kept[shortened].max() + step
    else:
        assert not shortened.any()


def test_all_columns_move_together() -> None:
    times = np.r_[0:100:0.1, 1e9 : 1e9 + 100 : 0.1]
    attitude = Series.of(times[::5], np.zeros((times[::5].size, 3)))
    sound = with_sound_times(track(times, attitude_rad=attitude))
    assert sound.attitude_rad is not None
    np.testing.assert_allclose(sound.attitude_rad.time_s, sound.compasses[1].time_s[::5])


@pytest.mark.parametrize("step_s", [0.0, 1e-9, 1e-6])
def test_what_has_no_clock_is_left_out_and_told(step_s: float) -> None:
    still = Series.of(20.0 + step_s * np.arange(100), np.zeros(100))
    sound = with_sound_times(track(0.1 * np.arange(100), throttle=still))
    assert sound.throttle is None and list(sound.compasses) == [1]
    assert sound.notes[-1].startswith("Left out throttle: ")
    assert not with_sound_times(track(still.time_s)).compasses
