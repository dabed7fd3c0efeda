"""ULog: PX4's raw and corrected fields, in body axes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from ulog_builder import ULogFile

from mavcompass.calibration.calibrate import calibrate_track
from mavcompass.compass_parameters import px4_correction
from mavcompass.errors import BadRecording
from mavcompass.frames import euler_to_matrix
from mavcompass.heading.deviation import heading_change_rad
from mavcompass.logs import read_track

SLOWER = ("vehicle_local_position", "actuator_controls_0", "vehicle_attitude")


def modern(path: Path, rotation: int = 2, yaw_deg: float = 0.0) -> Path:
    log = ULogFile()
    log.topic(
        "sensor_mag", "uint64_t timestamp_sample", "uint32_t device_id", "float x", "float y", "float z"
    )
    log.topic("vehicle_magnetometer", "uint32_t device_id", "float[3] magnetometer_ga")
    log.topic("battery_status", "float current_a")
    log.topic("vehicle_attitude", "float[4] q")
    log.topic("actuator_motors", "float[4] control")
    log.topic("vehicle_status", "uint8_t vehicle_type")
    log.parameter("CAL_MAG0_ID", 77).parameter("CAL_MAG1_ID", 55).parameter("CAL_MAG1_ROT", rotation)
    log.parameter("CAL_MAG1_XOFF", 0.1).parameter("CAL_MAG1_YAW", yaw_deg)
    for n in range(10):
        now = 2_000_000 + n * 20_000
        log.add("sensor_mag", now + 500, now, 55, 0.1, 0.02, -0.4)
        log.add("vehicle_magnetometer", now, 55, -0.02, 0.0, -0.4)
        log.add("battery_status", now, -1.0 if n < 5 else 3.0)
        log.add("vehicle_attitude", now, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
        log.add("actuator_motors", now, 0.5, np.nan, 0.25, 0.0)
        log.add("vehicle_status", now, 1)
    return log.write(path)


def test_raw_sensor_is_turned_into_body_axes_and_found_by_its_id(tmp_path: Path) -> None:
    track = read_track(modern(tmp_path / "a.ulg"))
    assert (track.autopilot, track.vehicle, list(track.compasses)) == ("px4", "copter", [2])
    compass = track.compasses[2]
    assert compass.correction_known and compass.device_id == 55
    np.testing.assert_allclose(track.raw_field(2), [[-20.0, 100.0, -400.0]] * 10, atol=1e-5)
    np.testing.assert_allclose(compass.time_s, 2.0 + 0.02 * np.arange(10))


def test_raw_readings_know_the_calibration_that_is_kept_out_of_them(tmp_path: Path) -> None:
    """The gap of such a recording once was the iron that the vehicle's own calibration cures."""
    log = ULogFile()
    log.topic("sensor_mag", "uint32_t device_id", "float x", "float y", "float z")
    for axis, offset in zip("XYZ", (0.1, -0.02, 0.03), strict=True):
        log.parameter(f"CAL_MAG0_{axis}OFF", offset)
    log.parameter("CAL_MAG0_ID", 55)
    for n in range(10):
        log.add("sensor_mag", 2_000_000 + n * 20_000, 55, 0.1, 0.02, -0.4)
    compass = read_track(log.write(tmp_path / "a.ulg")).compasses[1]
    assert compass.not_applied is not None
    assert compass.not_applied.offsets_mgauss == pytest.approx((-100.0, 20.0, -30.0))
    assert [step.correction.offsets_mgauss for step in compass.in_force] == [(0.0, 0.0, 0.0)]


def test_other_columns_are_in_the_units_used_inside(tmp_path: Path) -> None:
    track = read_track(modern(tmp_path / "a.ulg"))
    assert track.attitude_rad is not None and track.current_a is not None and track.motors is not None
    np.testing.assert_allclose(track.attitude_rad.values, [[0.0, 0.0, np.pi / 2]] * 10, atol=1e-6)
    assert track.current_a.values.tolist() == [3.0] * 5
    assert track.motors.values[0].tolist() == [0.5, 0.25, 0.0]


def test_the_place_date_and_thrust_of_an_older_firmware(tmp_path: Path) -> None:
    log = ULogFile()
    log.topic("vehicle_magnetometer", "uint32_t device_id", "float[3] magnetometer_ga")
    log.topic(
        "vehicle_gps_position",
        *("uint64_t time_utc_usec", "int32_t lat", "int32_t lon", "int32_t alt", "uint8_t fix_type"),
    )
    log.topic("vehicle_thrust_setpoint", "float[3] xyz")
    for n in range(4):
        now = 2_000_000 + n * 20_000
        log.add("vehicle_magnetometer", now, 55, 0.2, 0.0, -0.4)
        fix, utc_us = (3, 1_700_000_000_000_000 + now) if n else (0, 0)
        log.add("vehicle_gps_position", now, utc_us, 473_000_000, -1_790_000_000, 500_000, fix)
        log.add("vehicle_thrust_setpoint", now, 0.3, 0.0, -0.4)
    track = read_track(log.write(tmp_path / "a.ulg"))
    assert track.place is not None and track.throttle is not None and track.utc_offset_s is not None
    np.testing.assert_allclose(track.place.values, [[47.3, -179.0, 500.0]] * 3)
    np.testing.assert_allclose(track.throttle.values, [0.5] * 4)
    assert track.utc_offset_s == pytest.approx(1_700_000_000.0)


@pytest.mark.parametrize("prime", [66, None])
def test_a_corrected_field_that_names_no_sensor_is_of_the_one_that_steers(
    tmp_path: Path, prime: int | None
) -> None:
    """As of PX4 1.11: CAL_MAG_PRIME tells the one that steers; else it is one of those that there are."""
    log = ULogFile()
    log.topic("sensor_mag", "uint32_t device_id", "float x", "float y", "float z")
    log.topic("vehicle_magnetometer", "float[3] magnetometer_ga")
    for slot, device in enumerate((55, 66)):
        log.parameter(f"CAL_MAG{slot}_ID", device)
        for n in range(10):
            log.add("sensor_mag", 2_000_000 + n * 1_000_000, device, 0.1, 0.02, -0.4, instance=slot)
    if prime is not None:
        log.parameter("CAL_MAG_PRIME", prime)
    for n in range(140):
        log.add("vehicle_magnetometer", 2_000_000 + n * 70_000, 0.2, 0.0, -0.4)
    found = read_track(log.write(tmp_path / "a.ulg")).compasses
    assert {i: len(c.reported) for i, c in found.items()} == {1: 10, 2: 140 if prime else 10}


def test_free_angles_turn_the_readings_and_a_number_that_px4_does_not_know_does_not(tmp_path: Path) -> None:
    turned = read_track(modern(tmp_path / "a.ulg", rotation=100, yaw_deg=-90.0))
    np.testing.assert_allclose(turned.raw_field(2)[0], [20.0, -100.0, -400.0], atol=1e-5)
    not_turned = read_track(modern(tmp_path / "b.ulg", rotation=88))
    np.testing.assert_allclose(not_turned.raw_field(2)[0], [100.0, 20.0, -400.0], atol=1e-5)


def flight(path: Path, raw_every: int = 14, learnt_gauss: float = 0.0, step_us: int = 71_429) -> Path:
    """Log a compass whose calibration is written at 7 s and loaded at 8 s; what was written at 1 s never is.

    One of its values was written at 1 s already.
    """
    log = ULogFile()
    log.topic(
        "sensor_mag", "uint64_t timestamp_sample", "uint32_t device_id", "float x", "float y", "float z"
    )
    log.topic(
        "vehicle_magnetometer",
        "uint64_t timestamp_sample",
        "uint32_t device_id",
        "float[3] magnetometer_ga",
        "uint8_t calibration_count",
    )
    log.topic(
        "magnetometer_bias_estimate",
        "float[4] bias_x",
        "float[4] bias_y",
        "float[4] bias_z",
        "uint8_t[4] valid",
    )
    log.parameter("CAL_MAG0_ID", 55).parameter("CAL_MAG0_ROT", -1)
    for axis, old in zip("XYZ", (0.1, 0.0, 0.0), strict=True):
        log.parameter(f"CAL_MAG0_{axis}OFF", old).parameter(f"CAL_MAG0_{axis}SCALE", 1.0)
    if learnt_gauss:
        log.add("magnetometer_bias_estimate", 900_000, *[learnt_gauss] * 4, *[0.0] * 8, *[1] * 4)
    for n in range(126):
        now = 1_000_000 + n * step_us
        if n == 1:
            log.parameter("CAL_MAG0_ZOFF", 0.7).parameter("CAL_MAG0_XOFF", 0.3)
        if n == 84:
            log.parameter("CAL_MAG0_XOFF", 0.3).parameter("CAL_MAG0_YSCALE", 2.0)
        x = 0.4 + 0.001 * n
        in_force, bias = ((0.3, 2.0), 0.0) if n >= 98 else ((0.1, 1.0), learnt_gauss)
        if n % raw_every == 0:
            log.add("sensor_mag", now + 500, now, 55, x, 0.02, -0.4)
        corrected = (x - in_force[0] - bias, in_force[1] * 0.02, -0.4)
        log.add("vehicle_magnetometer", now + 900, now, 55, *corrected, 7 + (n >= 98))
    return log.write(path)


@pytest.mark.parametrize("learnt_gauss", [0.0, 0.05])
def test_where_raw_readings_are_sparse_the_corrected_ones_are_undone(
    tmp_path: Path, learnt_gauss: float
) -> None:
    track = read_track(flight(tmp_path / "a.ulg", learnt_gauss=learnt_gauss))
    (compass,) = track.compasses.values()
    assert len(compass.reported) == 126 and compass.correction_known and compass.device_id == 55
    expected = [[400.0 + n, 20.0, -400.0] for n in range(126)]
    np.testing.assert_allclose(track.raw_field(1), expected, atol=1e-3)
    # Written in flight, in force on the ground.
    assert [round(step.from_s, 3) for step in compass.in_force[1:]] == [round(1.0 + 98 * 0.071429, 3)]


def test_raw_readings_that_are_dense_enough_are_taken_as_they_are(tmp_path: Path) -> None:
    track = read_track(flight(tmp_path / "a.ulg", raw_every=2))
    assert len(track.compasses[1].reported) == 63 and len(track.compasses[1].in_force) == 1


def test_raw_readings_that_come_more_slowly_than_a_vehicle_turns_are_not(tmp_path: Path) -> None:
    """Half as many as corrected ones, one a second: what PX4 1.13 logs by default."""
    track = read_track(flight(tmp_path / "a.ulg", raw_every=2, step_us=500_000))
    assert len(track.compasses[1].reported) == 126


def test_the_recorded_hover_gives_what_was_found_live(shared_data: Path) -> None:
    folder = shared_data / "px4-1.16"
    live = json.loads((folder / "copter_four_positions.json").read_text())["live_result"]
    whole = read_track(folder / "copter_four_positions.ulg")
    found = calibrate_track(whole.between(48.0, 1e9), "four-positions")  # the iron was put in before
    # A copter that hunts hides the lean that would show a biased accelerometer: that is claimed, too.
    assert found.accepted and found.heading_sigma_deg < 0.8
    change_rad = heading_change_rad(
        px4_correction(live, 1), found.correction, found.horizontal_mgauss, found.vertical_mgauss
    )
    assert np.degrees(np.sqrt((change_rad**2).mean())) < 0.3


def test_every_value_of_the_recorded_flight_equals_pyulogs(shared_data: Path) -> None:
    from pyulog import ULog

    path = shared_data / "real" / "px4-ulog" / "sample.ulg"
    combined = ULog(str(path)).get_dataset("sensor_combined").data
    track = read_track(path)
    for axis in range(3):
        for series, name, factor in (
            (track.compasses[1].reported, "magnetometer_ga", 1000.0),
            (track.acc_mps2, "accelerometer_m_s2", 1.0),
            (track.gyro_radps, "gyro_rad", 1.0),
        ):
            assert series is not None
            expected = combined[f"{name}[{axis}]"].astype(np.float64) * factor
            np.testing.assert_array_equal(series.values[:, axis], expected)
    whole = {name: ULog(str(path)).get_dataset(name).data for name in SLOWER}
    for name, series, fields in (
        ("vehicle_local_position", track.position_ned_m, ("x", "y", "z")),
        ("actuator_controls_0", track.throttle, ("control[3]",)),
    ):
        assert series is not None
        stamp = whole[name].get("timestamp_sample", whole[name]["timestamp"])  # of the value, if it is told
        np.testing.assert_array_equal(series.time_s, stamp * 1e-6)
        expected = np.stack([whole[name][field].astype(np.float64) for field in fields], axis=1)
        np.testing.assert_array_equal(series.values.reshape(expected.shape), expected)
    assert track.attitude_rad is not None
    q = np.stack([whole["vehicle_attitude"][f"q[{i}]"].astype(np.float64) for i in range(4)], axis=1)
    roll = np.arctan2(2 * (q[:, 0] * q[:, 1] + q[:, 2] * q[:, 3]), 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2))
    np.testing.assert_allclose(track.attitude_rad.values[:, 0], roll, atol=1e-6)
    assert track.compasses[1].correction_known
    offsets = track.compasses[1].in_force[0].correction.offsets_mgauss
    # An internal sensor on a board that the level calibration found 1.5 and 1.2 degrees off.
    level = euler_to_matrix(*np.radians([-1.50480055, 1.18706357, 0.0]))
    assert offsets == pytest.approx(level @ [-28.247, 200.208, 136.905], abs=1e-3)


def test_a_log_without_magnetometer_says_so(tmp_path: Path) -> None:
    log = ULogFile().topic("battery_status", "float current_a").add("battery_status", 1, 1.0)
    with pytest.raises(BadRecording, match="no magnetometer"):
        read_track(log.write(tmp_path / "a.ulg"))


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


HEAD = b"ULog\x01\x12\x35\x01" + bytes(8) + message(b"B", bytes(40))
SUBSCRIBED = message(b"A", b"\0\1\0" + b"sensor_mag")
NESTED = message(b"F", b"sensor_mag:b[65535] x;") + message(b"F", b"b:c[65535] y;")


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"\x30\x00\x00", "no magnetometer"),  # 48 bytes of a type that is not known should follow
        (message(b"F", b"sensor_mag:uint8_t[65535] x;") + 5 * SUBSCRIBED, "more than 32768 fields"),
        (message(b"F", b"sensor_mag:sensor_mag x;") + SUBSCRIBED, "more than 8 deep"),
        (NESTED + message(b"F", b"c:float x;") + SUBSCRIBED, "more than 32768 fields"),
    ],
)
def test_a_small_file_is_not_read_for_ever(tmp_path: Path, body: bytes, said: str) -> None:
    path = tmp_path / "a.ulg"
    path.write_bytes(HEAD + body)
    with pytest.raises(BadRecording, match=said):
        read_track(path)
