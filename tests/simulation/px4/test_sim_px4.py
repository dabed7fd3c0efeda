"""The simulated PX4 multicopter: what is different from ArduPilot."""

import math
import struct

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.compass_parameters import px4_correction, px4_sensor_to_body
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavType
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup

LOCAL, VELOCITY_AND_YAW, VELOCITY_AND_RATE = 1, 0x9C7, 0x5C7
OFFBOARD = 6.0
IRON = FieldCorrection((120.0, -80.0, 40.0), (1.05, 0.95, 1.0), (0.02, 0.0, -0.01))


def quiet(in_force):
    return [CompassSetup(CompassModel(IRON, noise_mgauss=0.0), in_force)] * 3


def stream_setpoints(s, seconds, **fields):
    """Send setpoints at 10 Hz: standing still, with a yaw or a yaw rate."""
    mask = VELOCITY_AND_YAW if "yaw" in fields else VELOCITY_AND_RATE
    new = []
    for _ in range(round(seconds * 10)):
        s.send(m.SetPositionTargetLocalNed(0, 1, 1, LOCAL, mask, **fields))
        new += s.wait(0.1)
    return new


def in_offboard(station, **options):
    s = station("px4-copter", **options)
    stream_setpoints(s, 1.0, yaw_rate=0.0)
    assert s.command(176, 1.0, OFFBOARD) == 0
    return s


def as_integer(value):
    return struct.unpack("<i", struct.pack("<f", value))[0]


def test_the_heartbeat_is_px4s_in_hold(station):
    s = station("px4-copter")
    s.wait(1.5)
    (beat,) = (b for b in s.of(m.Heartbeat) if b.autopilot == 12)
    assert (beat.type, beat.base_mode & 129) == (2, 129)
    assert (beat.custom_mode >> 16 & 0xFF, beat.custom_mode >> 24) == (4, 3)


@pytest.mark.parametrize("seed", range(6))
def test_every_seed_starts_with_a_bad_compass(station, seed):
    assert 15.0 < heading_error_rms_deg(station("px4-copter", seed=seed).vehicle) < 60.0


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ((115, 90.0, 30.0, 1.0, 1.0), 3),  # there is no command to turn
        ((246, 1.0), 2),  # armed, it does not restart
        ((511, 27.0, 100_000.0), 2),  # it has no RAW_IMU, neither as a stream
        ((512, 27.0), 4),  # nor once
    ],
)
def test_what_it_does_not_do_is_answered(station, command, answer):
    assert station("px4-copter").command(*command) == answer


def test_offboard_wants_setpoints_before_the_switch(station):
    s = station("px4-copter")
    assert s.command(176, 1.0, OFFBOARD) == 1
    stream_setpoints(s, 1.0, yaw_rate=0.0)
    assert s.command(176, 1.0, OFFBOARD) == 0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_offboard_turns_to_a_yaw(station, sign):
    s = in_offboard(station, calibration="exact", start_yaw_deg=0.0)
    stream_setpoints(s, 5.0, yaw=sign * math.pi / 2)
    assert s.turned_deg == pytest.approx(sign * 90.0, abs=3.0)


def test_offboard_turns_at_a_rate(station):
    s = in_offboard(station, calibration="exact")
    stream_setpoints(s, 2.0, yaw_rate=math.radians(30.0))
    assert math.degrees(s.vehicle.truth.yaw_rate_radps) == pytest.approx(30.0, abs=3.0)


def test_offboard_falls_back_to_hold_a_second_after_the_last_setpoint(station):
    s = in_offboard(station)
    stream_setpoints(s, 1.0, yaw_rate=0.5)
    s.wait(0.8)
    assert s.vehicle.firmware.status.mode == "OFFBOARD"
    s.wait(0.4)
    assert s.vehicle.firmware.status.mode == "HOLD"
    s.wait(2.0)
    assert abs(math.degrees(s.vehicle.truth.yaw_rate_radps)) < 3.0


def test_the_pilots_stick_takes_over(station):
    s = in_offboard(station)
    s.vehicle.pilot_moves_stick(4, 1600, for_s=1.0)
    assert s.vehicle.firmware.status.mode == "POSCTL"


def test_scaled_imu_carries_the_raw_field_in_the_sensors_axes(station):
    for seed in range(4):
        s = station("px4-copter", seed=seed, compasses=quiet(FieldCorrection()), armed=False, tilt_deg=0.0)
        s.stream(26, 10)
        s.wait(0.5)
        scaled = s.of(m.ScaledImu)[-1]
        rotation = px4_sensor_to_body(s.vehicle.firmware.store.values, 1)
        truth = s.vehicle.truth
        raw = rotation.T @ IRON.undo(truth.rotation.T @ truth.field_ned_mgauss)
        np.testing.assert_array_equal((scaled.xmag, scaled.ymag, scaled.zmag), np.trunc(raw))
        assert 20 <= scaled.temperature <= 60  # whole degrees


def test_highres_imu_carries_the_corrected_field_in_gauss(station):
    s = station("px4-copter", seed=2, compasses=quiet(IRON), armed=False, tilt_deg=0.0)
    s.stream(105, 10)
    s.wait(0.5)
    imu = s.of(m.HighresImu)[-1]
    truth = s.vehicle.truth
    expected = truth.rotation.T @ truth.field_ned_mgauss / 1000.0
    np.testing.assert_allclose((imu.xmag, imu.ymag, imu.zmag), expected, atol=2e-6)


def test_integers_travel_as_their_bytes(station):
    s = station("px4-copter")
    (told,) = s.ask(m.ParamRequestRead(1, 1, "CAL_MAG0_ID"), m.ParamValue)
    assert (told.param_type, as_integer(told.param_value)) == (6, 396825)
    value = struct.unpack("<f", struct.pack("<i", 42))[0]
    (echo,) = s.ask(m.ParamSet(1, 1, "CAL_MAG_SIDES", value, 6), m.ParamValue)
    assert as_integer(echo.param_value) == 42
    assert echo.param_index < echo.param_count


def test_a_write_of_the_wrong_type_is_refused(station):
    s = station("px4-copter")
    s.send(m.Heartbeat(type=MavType.GCS))
    assert s.ask(m.ParamSet(1, 1, "CAL_MAG_SIDES", 42.0, 9), m.ParamValue) == []
    assert "param types mismatch" in s.texts()[-1]
    (told,) = s.ask(m.ParamRequestRead(1, 1, "CAL_MAG_SIDES"), m.ParamValue)
    assert as_integer(told.param_value) == 63


def test_each_element_is_echoed_once(station):
    s = station("px4-copter")
    assert [e.param_id for e in s.set("CAL_MAG0_XOFF", 0.1)] == ["CAL_MAG0_XOFF"]


def test_offsets_written_take_effect_subtracted_in_the_sensors_axes(station):
    s = station("px4-copter", seed=1, compasses=quiet(IRON), armed=False, tilt_deg=0.0)
    s.stream(105, 10)
    s.wait(0.5)
    before = s.of(m.HighresImu)[-1]
    offset = s.read("CAL_MAG0_XOFF")
    s.set("CAL_MAG0_XOFF", offset + 0.1)
    s.wait(0.3)
    after = s.of(m.HighresImu)[-1]
    correction = px4_correction(s.vehicle.firmware.store.values, 1)
    rotation = px4_sensor_to_body(s.vehicle.firmware.store.values, 1)
    shift = -correction.matrix @ rotation @ [0.1, 0.0, 0.0]
    moved = (after.xmag - before.xmag, after.ymag - before.ymag, after.zmag - before.zmag)
    np.testing.assert_allclose(moved, shift, atol=1e-4)


@pytest.mark.parametrize(("name", "change"), [("XOFF", 0.004), ("XSCALE", 0.008), ("ZODIAG", 0.009)])
def test_a_tiny_change_is_not_loaded(station, name, change):
    s = station("px4-copter", seed=1, armed=False)
    in_force = s.vehicle.firmware.compasses.correction(1)
    s.set(f"CAL_MAG0_{name}", s.read(f"CAL_MAG0_{name}") + change)
    assert s.vehicle.firmware.compasses.correction(1) == in_force
    s.set(f"CAL_MAG0_{name}", s.read(f"CAL_MAG0_{name}") + change)
    assert s.vehicle.firmware.compasses.correction(1) != in_force


def test_what_is_written_in_flight_is_not_loaded_and_overwritten_when_it_is_disarmed(station):
    s = station("px4-copter", seed=1)
    in_force = s.vehicle.firmware.compasses.correction(1)
    scale = s.read("CAL_MAG0_XSCALE")
    s.set("CAL_MAG0_XOFF", 0.9)
    s.set("CAL_MAG0_XSCALE", 1.3)
    assert s.vehicle.firmware.compasses.correction(1) == in_force
    assert s.command(21) == 0
    s.wait(25.0)
    assert not s.vehicle.firmware.status.armed
    assert abs(s.read("CAL_MAG0_XOFF") - 0.9) > 0.1  # what it flew with, and what it learnt
    assert s.read("CAL_MAG0_XSCALE") == pytest.approx(scale, abs=1e-6)


def test_a_calibration_that_is_loaded_resets_the_heading(station):
    s = station("px4-copter", seed=1, armed=False, tilt_deg=0.0)
    s.wait(5.0)
    estimate = s.vehicle.firmware.board.filter
    before_rad = estimate.yaw_rad
    s.set("CAL_MAG0_XOFF", s.read("CAL_MAG0_XOFF") + 0.15)
    assert abs(math.degrees(estimate.yaw_rad - before_rad)) > 5.0
    assert estimate.yaw_rad == pytest.approx(s.vehicle.firmware.compasses.yaw(), abs=0.02)


def test_a_calibration_of_another_sensor_is_ignored(station):
    s = station("px4-copter", seed=1, armed=False)
    other = struct.unpack("<f", struct.pack("<i", 1234))[0]
    s.ask(m.ParamSet(1, 1, "CAL_MAG0_ID", other, 6), m.ParamValue)
    assert s.vehicle.firmware.compasses.correction(1) == FieldCorrection()


def test_it_takes_off_turns_in_offboard_and_lands(station):
    s = station("px4-copter", armed=False, ready_s=2.0, calibration="exact")
    assert s.command(400, 1.0) == 1  # no position yet, which it says to who asks
    assert not any(t.startswith("Preflight Fail") for t in s.texts())
    assert s.command(401) == 0
    s.send(m.Heartbeat(type=MavType.GCS))  # texts are told to ground stations only
    s.wait(0.1)
    assert any(t.startswith("Preflight Fail") for t in s.texts())
    s.wait(4.0)
    assert s.command(400, 1.0) == 0
    assert s.command(22, 0, 0, 0, 0, 0, 0, math.nan) == 0
    s.wait(6.0)
    assert s.vehicle.firmware.status.mode == "HOLD"
    assert s.vehicle.truth.position_ned_m[2] == pytest.approx(-2.5, abs=0.4)
    assert s.command(400, 0.0) == 2
    assert s.command(21) == 0
    s.wait(12.0)
    assert not s.vehicle.firmware.status.armed
    assert s.vehicle.truth.position_ned_m[2] == 0.0


def test_fixed_yaw_calibration_cures_hard_iron_on_the_ground(station):
    wrong = FieldCorrection((220.0, -80.0, 40.0))
    s = station("px4-copter", seed=3, armed=False, compasses=quiet(wrong), tilt_deg=0.0)
    s.wait(1.0)
    assert heading_error_rms_deg(s.vehicle) > 15.0
    assert s.command(42006, round(s.turned_deg) % 360.0) == 0
    assert heading_error_rms_deg(s.vehicle) < 4.0  # the soft iron stays


def test_an_empty_battery_lands_it(station):
    s = station("px4-copter")
    s.vehicle.battery_failsafe()
    s.wait(25.0)
    assert not s.vehicle.firmware.status.armed
    assert s.vehicle.truth.position_ned_m[2] == 0.0
