"""How the simulated copter and sub fly, turn and land."""

import math

import numpy as np
import pytest

from mavcompass import messages as m

YAW_ONLY, STAND_AND_YAW, STAND_AND_RATE = 0x9FF, 0x9C7, 0x5C7


def exact(station, vehicle="copter", **options):
    return station(vehicle, calibration="exact", **options)


def turned(s, seconds):
    before = s.vehicle.truth.yaw_rad
    s.wait(seconds)
    return math.degrees((s.vehicle.truth.yaw_rad - before + math.pi) % (2 * math.pi) - math.pi)


def time_to_turn(s, angle_deg):
    start = s.vehicle.truth.yaw_rad
    for i in range(200):
        s.wait(0.05)
        by = math.degrees((s.vehicle.truth.yaw_rad - start + math.pi) % (2 * math.pi) - math.pi)
        if abs(by) >= angle_deg - 1.0:
            return (i + 1) * 0.05
    return math.inf


@pytest.mark.parametrize(("rate", "low", "high"), [(30.0, 2.9, 3.6), (0.0, 1.4, 2.2)])
def test_condition_yaw_takes_its_time(station, rate, low, high):
    s = exact(station)
    assert s.command(115, 90.0, rate, 1.0, 1.0) == 0
    assert low <= time_to_turn(s, 90.0) + 0.2 <= high


@pytest.mark.parametrize("vehicle", ["copter", "sub"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_relative_turns_end_where_they_should(station, vehicle, direction):
    s = exact(station, vehicle)
    before = s.vehicle.truth.yaw_rad
    assert s.command(115, 90.0, 30.0, direction, 1.0) == 0
    s.wait(8.0)
    by = math.degrees((s.vehicle.truth.yaw_rad - before + math.pi) % (2 * math.pi) - math.pi)
    assert by == pytest.approx(direction * 90.0, abs=2.5)


def test_absolute_turns_obey_the_direction(station):
    s = exact(station, start_yaw_deg=0.0)
    assert s.command(115, 90.0, 60.0, -1.0, 0.0) == 0
    assert turned(s, 1.5) < -40.0
    s.wait(8.0)
    assert s.turned_deg == pytest.approx(90.0, abs=2.5)


@pytest.mark.parametrize("params", [(-90.0, 30.0, 1.0, 1.0), (361.0, 30.0, 1.0, 0.0), (90.0, 30.0, 1.0, 2.0)])
def test_condition_yaw_fails_outside_its_ranges(station, params):
    assert station("copter").command(115, *params) == 4


def test_condition_yaw_is_accepted_on_the_ground_and_turns_nothing(station):
    s = station("copter", armed=False)
    assert s.command(115, 90.0, 30.0, 1.0, 1.0) == 0
    assert turned(s, 4.0) == 0.0


def test_condition_yaw_is_accepted_in_other_modes_and_turns_nothing(station):
    s = exact(station)
    assert s.command(176, 1.0, 17.0) == 0
    assert s.command(115, 90.0, 30.0, 1.0, 1.0) == 0
    assert abs(turned(s, 4.0)) < 3.0
    assert s.vehicle.truth.position_ned_m[2] == pytest.approx(-8.0, abs=0.5)


def test_a_repeated_relative_turn_restarts_from_the_present_yaw(station):
    s = exact(station)
    before = s.vehicle.truth.yaw_rad
    s.command(115, 90.0, 30.0, 1.0, 1.0)
    s.wait(0.8)
    s.command(115, 90.0, 30.0, 1.0, 1.0)
    s.wait(8.0)
    by = math.degrees((s.vehicle.truth.yaw_rad - before) % (2 * math.pi))
    assert 100.0 < by < 135.0


@pytest.mark.parametrize(("mask", "deg", "within"), [(YAW_ONLY, 0.0, 2.0), (STAND_AND_YAW, 90.0, 3.0)])
def test_copter_turns_by_velocity_zero_and_yaw_and_ignores_yaw_alone(station, mask, deg, within):
    s = exact(station)
    s.send(m.SetPositionTargetLocalNed(0, 1, 1, 9, mask, yaw=math.pi / 2))
    assert turned(s, 5.0) == pytest.approx(deg, abs=within)


def test_copter_turns_by_velocity_zero_and_yaw_rate_until_the_targets_end(station):
    s = exact(station)
    s.send(m.SetPositionTargetLocalNed(0, 1, 1, 9, STAND_AND_RATE, yaw_rate=math.radians(20.0)))
    assert turned(s, 2.5) == pytest.approx(48.0, abs=6.0)
    s.wait(2.0)
    assert abs(math.degrees(s.vehicle.truth.yaw_rate_radps)) < 3.0


def test_a_velocity_target_without_yaw_rate_stops_a_turn(station):
    s = exact(station)
    s.command(115, 180.0, 45.0, 1.0, 1.0)
    s.wait(1.5)
    s.send(m.SetPositionTargetLocalNed(0, 1, 1, 9, STAND_AND_RATE, yaw_rate=0.0))
    s.wait(1.0)
    assert abs(turned(s, 3.0)) < 6.0


def test_copter_hovers_with_small_swings_and_a_current_of_28_amperes(station):
    s = exact(station)
    s.stream(164, 20)
    s.stream(1, 4)
    s.wait(30.0)
    roll = np.degrees([t.roll for t in s.of(m.Simstate)])
    assert 0.1 < np.std(roll) < 1.0
    current = np.mean([t.current_battery for t in s.of(m.SysStatus)]) / 100.0
    assert current == pytest.approx(28.0, abs=1.0)


def test_running_motors_shake_the_accelerometer(station):
    flying, standing = exact(station), exact(station, armed=False)
    noise = []
    for s in (flying, standing):
        s.stream(27, 100)
        noise.append(np.std([i.zacc for i in s.of(m.RawImu, s.wait(5.0))]))
    assert noise[0] > 10.0 * noise[1]


def test_copter_takes_off_turns_and_lands(station):
    s = exact(station, armed=False, ready_s=1.0)
    s.stream(245, 4)
    s.wait(4.0)
    assert s.of(m.ExtendedSysState)[-1].landed_state == 1
    assert s.command(22, 0, 0, 0, 0, 0, 0, 8.0) == 4  # not armed
    assert s.command(176, 1.0, 4.0) == 0
    assert s.command(400, 1.0) == 0
    assert s.command(22, 0, 0, 0, 0, 0, 0, 8.0) == 0
    s.wait(9.0)
    assert s.vehicle.truth.position_ned_m[2] == pytest.approx(-8.0, abs=0.5)
    assert s.of(m.ExtendedSysState)[-1].landed_state == 2
    assert s.command(400, 0.0) == 4  # it flies
    assert s.command(176, 1.0, 9.0) == 0
    s.wait(20.0)
    assert not s.vehicle.firmware.status.armed
    assert s.vehicle.truth.position_ned_m[2] == 0.0


def test_the_filter_takes_the_compasss_yaw_over_on_leaving_the_ground(station):
    s = exact(station, armed=False, ready_s=1.0)
    s.wait(4.0)
    s.command(176, 1.0, 4.0)
    s.command(400, 1.0)
    s.vehicle.filter.yaw_rad += 0.5
    s.command(22, 0, 0, 0, 0, 0, 0, 8.0)
    s.wait(1.0)
    assert abs(s.ekf_error_deg) > 15.0
    s.wait(5.0)
    assert "EKF3 IMU0 MAG0 in-flight yaw alignment complete" in s.texts()
    assert abs(s.ekf_error_deg) < 3.0


def test_copter_idle_on_the_ground_disarms_itself(station):
    s = exact(station, armed=False, ready_s=1.0)
    s.wait(4.0)
    s.command(176, 1.0, 4.0)
    assert s.command(400, 1.0) == 0
    s.wait(8.0)
    assert s.vehicle.firmware.status.armed
    s.wait(3.0)
    assert not s.vehicle.firmware.status.armed


def test_loiter_with_a_low_throttle_stick_comes_down(station):
    s = exact(station)
    assert s.command(176, 1.0, 5.0) == 0
    s.wait(25.0)
    assert s.vehicle.truth.position_ned_m[2] == 0.0
    assert not s.vehicle.firmware.status.armed


def test_an_empty_battery_brings_the_copter_down(station):
    s = exact(station)
    s.vehicle.battery_failsafe()
    s.wait(2.0)
    beat = [b for b in s.of(m.Heartbeat) if b.autopilot == 3][-1]
    assert (beat.custom_mode, beat.system_status) == (9, 5)
    assert "Battery Failsafe" in s.texts()


def test_sub_holds_its_depth(station):
    s = exact(station, "sub")
    s.wait(10.0)
    assert s.vehicle.truth.position_ned_m[2] == pytest.approx(3.0, abs=0.2)


def test_a_copter_disarmed_in_the_air_falls_and_a_sub_rises(station):
    copter, sub = exact(station), exact(station, "sub")
    for s in (copter, sub):
        assert s.command(400, 0.0, 21196.0) == 0
        s.wait(4.0)
    assert copter.vehicle.truth.position_ned_m[2] == 0.0
    assert 2.0 < sub.vehicle.truth.position_ned_m[2] < 2.9
