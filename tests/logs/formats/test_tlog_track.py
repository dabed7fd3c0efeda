"""What a person finds in the Track of a telemetry log."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect
from recorded_frames import Recording, attitude, heartbeat, parameter, raw_imu, scaled_imu, sys_status

from mavcompass.errors import BadRecording
from mavcompass.logs import read_track, read_tracks
from mavcompass.track import Track
from mavcompass.vehicle.replay.answers import survey


def offsets(
    recording: Recording, log_s: float, xyz: tuple[float, float, float], first_index: int = 0
) -> None:
    for number, (axis, value) in enumerate(zip("XYZ", xyz, strict=True)):
        recording.add(log_s, parameter(f"COMPASS_OFS_{axis}", value, index=first_index + number))


def test_corrected_readings_come_with_the_correction_inside_them(tmp_path: Path) -> None:
    recording = Recording()
    offsets(recording, 0.0, (5.0, 13.0, -18.0))
    track = read_track(recording.fly(5.0).write(tmp_path / "a.tlog"))
    compass = track.compasses[1]
    assert (track.autopilot, track.vehicle) == ("ardupilot", "rover")
    assert compass.correction_known and compass.truncated and compass.quantum_mgauss == 1.0
    np.testing.assert_array_equal(compass.reported.values, [[200.0, 50.0, -500.0]] * 50)
    np.testing.assert_array_equal(track.raw_field(1), [[195.0, 37.0, -482.0]] * 50)
    np.testing.assert_allclose(compass.time_s, 20.0 + 0.1 * np.arange(50))
    assert track.acc_mps2 is not None and track.gyro_radps is not None
    assert track.acc_mps2.time_s is track.gyro_radps.time_s is compass.time_s
    assert track.acc_mps2.values[0].tolist() == [0.0, 0.0, -9.80665]
    assert track.gyro_radps.values[7].tolist() == [0.0, 0.0, 0.007]
    assert track.attitude_rad is not None and track.attitude_rad.values[0, 2] == pytest.approx(0.1)
    assert track.utc_offset_s == pytest.approx(1_700_000_000 - 20.0 + 0.02, abs=1e-3)


def test_unknown_parameters_are_said_and_nothing_is_undone(tmp_path: Path) -> None:
    track = read_track(Recording().fly(2.0).write(tmp_path / "a.tlog"))
    assert not track.compasses[1].correction_known
    np.testing.assert_array_equal(track.raw_field(1), track.compasses[1].reported.values)
    assert any("parameters of compass 1 are not in the recording" in note for note in track.notes)


def test_a_correction_changed_on_the_way_is_undone_with_its_time(tmp_path: Path) -> None:
    recording = Recording()
    offsets(recording, 0.0, (5.0, 13.0, -18.0))
    recording.fly(5.0)
    # Writing X makes the vehicle announce X, Y and Z: Y and Z as they still are. Then Y is written.
    for axis, value in (("X", 105.0), ("Y", 13.0), ("Z", -18.0), ("Y", 63.0)):
        recording.add(5.0, parameter(f"COMPASS_OFS_{axis}", value))
    recording.fly(5.0, boot_s=25.0, log_s=5.0, mag=(300, 100, -500))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    steps = track.compasses[1].in_force
    assert steps[0].from_s == -math.inf
    assert all(24.9 <= step.from_s <= 25.0 for step in steps[1:])
    assert steps[-1].correction.offsets_mgauss == (105.0, 63.0, -18.0)
    np.testing.assert_array_equal(track.raw_field(1), [[195.0, 37.0, -482.0]] * 100)
    assert track.parameters["COMPASS_OFS_Y"] == 63.0


def test_the_whole_correction_of_the_firmware_is_undone(tmp_path: Path) -> None:
    recording = Recording()
    values = {"OFS_X": 10.0, "OFS_Y": 20.0, "OFS_Z": 30.0, "DIA_X": 1.25, "DIA_Y": 0.8, "DIA_Z": 1.0}
    for name, value in {**values, "MOT_X": 2.0, "MOTCT": 2.0}.items():
        recording.add(0.0, parameter(f"COMPASS_{name}", value, index=1))
    recording.add(0.0, sys_status(1000)).fly(3.0, mag=(145, 96, -470))
    for n in range(30):
        recording.add(n * 0.1 + 0.022, sys_status(1000))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.current_a is not None and set(track.current_a.values.tolist()) == {10.0}
    np.testing.assert_allclose(track.raw_field(1)[1:], [[90.0, 100.0, -500.0]] * 29, atol=1e-4)


def test_offsets_of_old_firmware_come_from_sensor_offsets(tmp_path: Path) -> None:
    message = dialect.MAVLink_sensor_offsets_message(11, -12, 13, 0.1, 0, 0, 0, 0, 0, 0, 0, 0)
    recording = Recording().fly(1.0).add(1.0, message).fly(1.0, boot_s=21.0, log_s=1.0)
    correction = read_track(recording.write(tmp_path / "a.tlog")).compasses[1].in_force[0].correction
    assert correction.offsets_mgauss == (11.0, -12.0, 13.0)


def test_the_vehicle_is_found_by_what_it_is_not_by_who_is_heard_first(tmp_path: Path) -> None:
    recording = Recording().add(0.0, heartbeat("ground station"), system=1, component=190)
    for n in range(50):
        recording.add(n * 0.1, heartbeat("gimbal"), system=1, component=154)
        recording.add(n * 0.1, raw_imu(1.0 + n, (1, 2, 3)), system=1, component=154)
    recording.fly(3.0, system=1, component=1, kind="copter")
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert (track.vehicle, len(track.compasses[1].reported)) == ("copter", 30)


def test_what_a_station_fetched_as_a_file_is_the_vehicles_and_a_gimbals_is_not(tmp_path: Path) -> None:
    """MAVProxy logs it under the vehicle's system and an address that has no heartbeat."""
    recording = Recording().add(0.0, heartbeat("gimbal"), component=154)
    for number, (axis, value) in enumerate(zip("XYZ", (5.0, 13.0, -18.0), strict=True)):
        recording.add(0.1, parameter(f"COMPASS_OFS_{axis}", value, index=number), component=190)
        recording.add(0.2, parameter(f"COMPASS_OFS_{axis}", 99.0, index=number), component=154)
    recording.fly(5.0).add(5.0, parameter("COMPASS_OFS_X", 105.0)).fly(5.0, boot_s=25.0, log_s=5.0)
    path = recording.write(tmp_path / "a.tlog")
    compass = read_track(path).compasses[1]
    assert compass.correction_known
    assert [step.correction.offsets_mgauss[0] for step in compass.in_force] == [5.0, 105.0]
    assert [survey(path).parameters[f"COMPASS_OFS_{axis}"].param_value for axis in "XYZ"] == [
        5.0,
        13.0,
        -18.0,
    ]


def test_several_vehicles_in_one_file_are_told_apart(tmp_path: Path) -> None:
    recording = Recording().fly(3.0, system=7, mag=(100, 0, -500))
    recording.fly(6.0, system=2, mag=(300, 0, -500), kind="copter", boot_s=900.0)
    recording.fly(1.0, system=255, component=190, kind="ground station")
    path = recording.write(tmp_path / "a.tlog")
    tracks = read_tracks(path)
    assert {system: track.vehicle for system, track in tracks.items()} == {2: "copter", 7: "rover"}
    assert tracks[7].compasses[1].reported.values[:, 0].tolist() == [100.0] * 30
    one = read_track(path)
    assert one.compasses[1].reported.values[0, 0] == 300.0
    assert any("2 vehicles" in note and "system 2" in note for note in one.notes)


def test_of_vehicles_that_share_a_system_id_the_one_that_said_most_is_read(tmp_path: Path) -> None:
    """One ground station, several vehicles that nobody told apart: in the file one follows the other, though
    they were heard at the same time."""
    recording = Recording().fly(20.0, boot_s=100.0).fly(40.0, boot_s=30.0, log_s=5.0, mag=(300, 0, -500))
    recording.fly(10.0, boot_s=31.0, log_s=6.0)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.compasses[1].reported.values[:, 0].tolist() == [300.0] * 400
    assert any("share a system id" in note and "SYSID_THISMAV" in note for note in track.notes)
    assert not any("started" in note for note in track.notes)


def test_a_clock_of_microseconds_that_was_started_later_is_put_right(tmp_path: Path) -> None:
    recording = Recording().add(0.0, heartbeat("rover"))
    for n in range(200):
        delay = 0.02 + 0.1 * (n % 7 == 0)
        recording.add(n * 0.1 + delay, attitude(50.0 + n * 0.1))
        recording.add(n * 0.1 + delay, raw_imu(45.57 + n * 0.1, (200, 0, n)))
    times = read_track(recording.write(tmp_path / "a.tlog")).compasses[1].time_s
    np.testing.assert_allclose(times, 50.0 + 0.1 * np.arange(200), atol=0.02)


def test_time_goes_on_across_a_restart_by_as_much_as_the_log_says(tmp_path: Path) -> None:
    recording = Recording().fly(10.0, boot_s=100.0).fly(10.0, boot_s=5.0, log_s=60.0)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    times = track.compasses[1].time_s
    assert bool((np.diff(times) > 0.0).all())
    assert times[0] == pytest.approx(100.0)
    assert times[100] - times[99] == pytest.approx(50.1, abs=0.05)
    assert any("started 2 times" in note for note in track.notes)
    assert track.attitude_rad is not None
    assert track.attitude_rad.time_s[100] == pytest.approx(times[100])


def test_parameters_read_after_a_restart_held_since_then(tmp_path: Path) -> None:
    recording = Recording()
    offsets(recording, 0.0, (5.0, 0.0, 0.0))
    recording.fly(10.0, boot_s=100.0).fly(5.0, boot_s=5.0, log_s=60.0, mag=(295, 50, -500))
    offsets(recording, 65.0, (100.0, 0.0, 0.0))
    recording.fly(5.0, boot_s=10.0, log_s=65.0, mag=(295, 50, -500))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    np.testing.assert_array_equal(track.raw_field(1)[:, 0], [195.0] * 200)


def test_files_put_together_in_the_wrong_order_still_go_forward_in_time(tmp_path: Path) -> None:
    recording = Recording().fly(5.0, boot_s=200.0, log_s=1000.0).fly(5.0, boot_s=50.0, log_s=0.0)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    times = track.compasses[1].time_s
    assert bool((np.diff(times) > 0.0).all())
    assert track.duration_s == pytest.approx(10.9, abs=0.2)


def test_late_messages_are_put_in_order_and_repeated_ones_left_out(tmp_path: Path) -> None:
    recording = Recording().fly(5.0)
    late = recording.records.pop(20)
    recording.records.insert(31, late)
    recording.records += recording.records[-4:]
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert bool((np.diff(track.compasses[1].time_s) > 0.0).all())
    assert len(track.compasses[1].reported) == 50
    assert any("recorded twice" in note for note in track.notes)


def test_the_ground_stations_clock_may_jump(tmp_path: Path) -> None:
    recording = Recording().fly(5.0).fly(5.0, boot_s=25.0, log_s=3605.0)
    recording.add(3610.0, sys_status(500))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.duration_s == pytest.approx(9.9)
    assert track.current_a is not None and track.current_a.time_s[0] == pytest.approx(29.9, abs=0.2)
    assert any("clock jumped" in note for note in track.notes)


def test_one_message_with_an_impossible_time_is_placed_by_its_arrival(tmp_path: Path) -> None:
    recording = Recording().fly(5.0)
    recording.add(5.0, attitude(9e5)).fly(5.0, boot_s=25.0, log_s=5.0)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.attitude_rad is not None and len(track.attitude_rad) == 101
    assert track.attitude_rad.time_s[50] == pytest.approx(24.9, abs=0.1)
    assert track.attitude_rad.time_s[-1] == pytest.approx(29.9)
    assert any("impossible time" in note for note in track.notes)


def test_messages_without_a_time_are_placed_between_their_neighbours(tmp_path: Path) -> None:
    recording = Recording()
    rng = np.random.default_rng(1)
    for n in range(200):
        delay = 0.01 + rng.exponential(0.2)  # a bad radio; the burst keeps its order
        log_s = max(n * 0.1 + delay, recording.records[-1][0] * 1e-6 - 1.7e9 if recording.records else 0.0)
        recording.add(log_s, attitude(50.0 + n * 0.1, yaw=n * 0.001))
        recording.add(log_s, dialect.MAVLink_simstate_message(0, 0, n * 0.001, *[0.0] * 6, 0, 0))
        recording.add(log_s, raw_imu(50.0 + n * 0.1, (200, 0, -500)))
    track = read_track(recording.add(0.0, heartbeat("rover")).write(tmp_path / "a.tlog"))
    assert track.truth_q is not None
    np.testing.assert_allclose(track.truth_q.time_s, 50.0 + 0.1 * np.arange(200), atol=1e-6)


def test_microseconds_that_wrap_after_71_minutes_go_on(tmp_path: Path) -> None:
    recording = Recording().add(0.0, heartbeat("rover"))
    wrap = 2**32 * 1e-6
    for n in range(100):
        boot_s = wrap - 5.0 + n * 0.1
        recording.add(n * 0.1, attitude(boot_s))
        recording.add(n * 0.1, raw_imu(boot_s % wrap, (200, 0, n)))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert len(track.compasses) == 1
    np.testing.assert_allclose(track.compasses[1].time_s, wrap - 5.0 + 0.1 * np.arange(100), atol=1e-3)


def test_microseconds_since_1970_are_brought_to_time_since_boot(tmp_path: Path) -> None:
    recording = Recording().add(0.0, heartbeat("rover"))
    for n in range(100):
        recording.add(n * 0.1, attitude(50.0 + n * 0.1))
        recording.add(n * 0.1 + 0.001 * (n % 3), raw_imu(1.7e9 + n * 0.1, (200, 0, n)))
    times = read_track(recording.write(tmp_path / "a.tlog")).compasses[1].time_s
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-5)
    assert times[0] == pytest.approx(50.0, abs=0.01)


def test_all_three_compasses_and_the_denser_message_for_the_first(tmp_path: Path) -> None:
    recording = Recording().fly(2.0)
    for n in range(40):
        recording.add(n * 0.05, scaled_imu(20.0 + n * 0.05, (210, 0, -500)))
        recording.add(n * 0.05, scaled_imu(20.0 + n * 0.05, (220, 0, -500), "2"))
        recording.add(n * 0.05, scaled_imu(20.0 + n * 0.05, (0, 0, 0), "3"))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert {i: c.reported.values[0, 0] for i, c in track.compasses.items()} == {1: 210.0, 2: 220.0}
    assert len(track.compasses[1].reported) == 40
    assert any("there is no compass 3" in note for note in track.notes)


@pytest.mark.parametrize("factor", [1.0, 1.0e6])
def test_highres_imu_of_ardupilot_is_understood_with_and_without_its_bug(
    tmp_path: Path, factor: float
) -> None:
    recording = Recording().add(0.0, heartbeat("rover"))
    for n in range(20):
        field = (0.2323 * factor, 0.05 * factor, -0.5 * factor)
        imu = dialect.MAVLink_highres_imu_message(
            1_000_000 + n * 100_000, 0, 0, -9.8, 0, 0, 0.1, *field, 0, 0, 0, 20, 0
        )
        recording.add(n * 0.1, imu)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.compasses[1].reported.values[0] == pytest.approx([232.3, 50.0, -500.0], rel=1e-5)
    assert not track.compasses[1].truncated and track.compasses[1].quantum_mgauss == 0.0
    assert track.gyro_radps is not None and track.gyro_radps.values[0, 2] == pytest.approx(0.1)


def px4(tmp_path: Path, *parameters: tuple[str, float, int]) -> Track:
    recording = Recording()
    for number, (name, value, kind) in enumerate(parameters):
        recording.add(0.0, parameter(name, value, index=number, kind=kind))
    recording.add(0.0, heartbeat("px4 copter"))
    for n in range(20):
        recording.add(n * 0.1, scaled_imu(5.0 + n * 0.1, (100, 20, -400)))
    return read_track(recording.write(tmp_path / "a.tlog"))


def as_integer_bytes(value: int) -> float:
    return float(np.array([value], dtype="<i4").view("<f4")[0])


def test_px4_reports_uncorrected_in_the_sensors_axes(tmp_path: Path) -> None:
    rotation_yaw_90 = ("CAL_MAG0_ROT", as_integer_bytes(2), 6)
    track = px4(tmp_path, rotation_yaw_90, ("CAL_MAG0_XOFF", 0.1, 9))
    assert track.autopilot == "px4"
    assert track.parameters["CAL_MAG0_ROT"] == 2.0
    np.testing.assert_allclose(track.raw_field(1), [[-20.0, 100.0, -400.0]] * 20, atol=1e-9)
    assert track.compasses[1].correction_known


def test_px4_reports_in_the_axes_that_free_angles_say(tmp_path: Path) -> None:
    free = [("CAL_MAG0_ROT", as_integer_bytes(100), 6), ("CAL_MAG0_YAW", -90.0, 9)]
    np.testing.assert_allclose(px4(tmp_path, *free).raw_field(1)[0], [20.0, -100.0, -400.0], atol=1e-9)


def test_px4_without_its_parameters_is_said_to_be_taken_as_not_rotated(tmp_path: Path) -> None:
    track = px4(tmp_path)
    np.testing.assert_array_equal(track.raw_field(1), [[100.0, 20.0, -400.0]] * 20)
    assert any("CAL_MAG0_ROT is not recorded" in note for note in track.notes)


@pytest.mark.parametrize("rotation_known", [True, False])
def test_px4_speaks_by_scaled_imu_since_its_estimator_bends_the_other(
    tmp_path: Path, rotation_known: bool
) -> None:
    recording = Recording()
    if rotation_known:
        recording.add(0.0, parameter("CAL_MAG0_ROT", as_integer_bytes(0), index=0, kind=6))
    recording.add(0.0, heartbeat("px4 copter"))
    for n in range(100):
        imu = dialect.MAVLink_highres_imu_message(
            5_000_000 + n * 20_000, 0, 0, -9.8, 0, 0, 0, 0.09, 0.02, -0.4, 0, 0, 0, 20, 0
        )
        recording.add(n * 0.02, imu)
        if n % 5 == 0:
            recording.add(n * 0.02, scaled_imu(5.0 + n * 0.02, (100, 20, -400)))
    track = read_track(recording.write(tmp_path / "a.tlog"))
    compass = track.compasses[1]
    assert len(compass.reported) == (20 if rotation_known else 100)
    assert compass.less_learnt is not rotation_known
    assert any("estimator learns" in note for note in track.notes) is not rotation_known


def test_motors_are_the_outputs_that_the_parameters_call_motors(tmp_path: Path) -> None:
    recording = Recording().fly(1.0)
    for number, function in ((1, 34), (2, 0), (3, 33)):
        recording.add(1.0, parameter(f"SERVO{number}_FUNCTION", function, index=1))
    for n in range(5):
        outputs = dialect.MAVLink_servo_output_raw_message(n, 0, 1250, 1900, 1750, 0, 0, 0, 0, 0)
        recording.add(1.0 + n * 0.2, outputs)
    track = read_track(recording.write(tmp_path / "a.tlog"))
    assert track.motors is not None
    np.testing.assert_allclose(track.motors.values, [[0.75, 0.25]] * 5)


def test_a_recording_without_magnetometer_says_how_to_get_one(tmp_path: Path) -> None:
    path = Recording().add(0.0, heartbeat("rover")).add(0.0, attitude(1.0)).write(tmp_path / "a.tlog")
    with pytest.raises(BadRecording, match="no magnetometer") as caught:
        read_track(path)
    assert "RAW_IMU" in caught.value.remedy


def test_a_recording_of_a_ground_station_alone_has_no_vehicle(tmp_path: Path) -> None:
    path = Recording().add(0.0, heartbeat("ground station"), system=255).write(tmp_path / "a.tlog")
    with pytest.raises(BadRecording, match="none from a vehicle"):
        read_track(path)


def test_real_quad_flight_with_two_power_ups(shared_data: Path) -> None:
    track = read_track(shared_data / "real" / "quad-flight-tlog" / "flight.tlog")
    assert track.vehicle == "copter" and list(track.compasses) == [1, 2]
    assert any("started 2 times" in note for note in track.notes)
    assert any("27613 bytes" in note for note in track.notes)
    assert track.current_a is not None and track.current_a.values.max() == pytest.approx(54.97)
    for compass in track.compasses.values():
        assert compass.correction_known
        assert bool((np.diff(compass.time_s) >= 0.0).all())
    assert track.duration_s == pytest.approx(1050.3, abs=1.0)


def test_the_simulators_truth_fits_the_field_it_reports(shared_data: Path) -> None:
    track = read_track(shared_data / "ardupilot-4.6.3" / "rover_plain.tlog")
    assert track.truth_q is not None
    q = track.truth_q.values
    yaw = np.unwrap(2.0 * np.arctan2(q[:, 3], q[:, 0]))
    field = track.compasses[2].reported
    heading = np.unwrap(np.arctan2(-field.values[:, 1], field.values[:, 0])) + np.radians(12.8)
    heading -= 2.0 * np.pi * np.round((heading[0] - yaw[0]) / (2.0 * np.pi))

    def rms_deg(lag_s: float) -> float:
        error = heading - np.interp(field.time_s - lag_s, track.truth_q.time_s, yaw)  # type: ignore[union-attr]
        return float(np.degrees(np.sqrt(np.mean(error**2))))

    # The firmware reads the compass at 10 Hz and averages it: the field lags the attitude by about 0.1 s.
    lags_s = np.arange(-0.5, 0.5, 0.02)
    best_s = lags_s[np.argmin([rms_deg(lag) for lag in lags_s])]
    assert 0.04 < best_s < 0.16
    assert rms_deg(best_s) < 1.0


def test_whole_numbers_of_the_imu_are_known_to_be_cut(tmp_path: Path) -> None:
    track = read_track(Recording().fly(2.0).write(tmp_path / "a.tlog"))
    assert track.acc_truncation_mps2 == pytest.approx(0.00980665)
    assert track.gyro_truncation_radps == 0.001


def test_the_receivers_velocity_is_kept_beside_the_filters(tmp_path: Path) -> None:
    recording = Recording()
    for n in range(10):
        boot_ms = 20_000 + 200 * n
        heard = dialect.MAVLink_gps_raw_int_message(
            boot_ms * 1000, 3, 470_000_000, 80_000_000, 0, 99, 99, 200, 9000, 9
        )
        recording.add(0.2 * n, heard)
        estimate = dialect.MAVLink_global_position_int_message(
            boot_ms, 470_000_000, 80_000_000, 0, 0, 100, -30, 5, 0
        )
        if n % 2:
            recording.add(0.2 * n, estimate)
    track = read_track(recording.fly(2.0).write(tmp_path / "a.tlog"))
    assert track.gps_velocity_mps is not None and track.receiver_velocity_mps is not None
    np.testing.assert_allclose(track.gps_velocity_mps.values, [[1.0, -0.3, 0.05]] * 5)
    np.testing.assert_allclose(track.receiver_velocity_mps.values, [[0.0, 2.0, np.nan]] * 10, atol=1e-9)
