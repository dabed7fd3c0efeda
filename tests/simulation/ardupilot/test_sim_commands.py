"""Arming, modes, rates and the calibration commands of the simulated ArduPilot."""

import math

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup

FINE = FieldCorrection((50.0, -30.0, 20.0))


def on_the_ground(station, wait_s=5.0, **options):
    """A rover that has just found its position, in GUIDED, disarmed."""
    options = {"armed": False, "ready_s": 2.0, "tilt_deg": 0.0} | options
    s = station(options.pop("vehicle", "rover"), **options)
    s.wait(wait_s)
    s.command(176, 1.0, float(s.vehicle.profile.guided_mode))
    return s


def compasses(*in_force):
    return [CompassSetup(CompassModel(FINE, 1.0), c) for c in in_force]


def refusal(s):
    assert s.command(400, 1.0) == 4
    return s.texts()[-1]


# --- message rates ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("vehicle", "granted", "denied"), [("rover", 40, 50), ("copter", 200, 400)])
def test_rates_above_the_loops_share_are_denied_and_the_old_one_stays(station, vehicle, granted, denied):
    s = station(vehicle)
    assert s.stream(27, granted) == 0
    assert s.stream(27, denied) == 2
    count = len(s.of(m.RawImu, s.wait(4.0)))
    assert count == pytest.approx(4 * granted, abs=2)


def test_an_interval_is_told_and_reset(station):
    s = station()
    s.stream(27, 10)
    (told,) = s.ask(m.CommandLong(1, 1, 512, 0, 244.0, 27.0), m.MessageInterval)
    assert (told.message_id, told.interval_us) == (27, 100_000)
    s.command(511, 27.0, 0.0)
    (told,) = s.ask(m.CommandLong(1, 1, 510, 0, 27.0), m.MessageInterval)
    assert told.interval_us == 1_000_000
    s.command(511, 27.0, -1.0)
    (told,) = s.ask(m.CommandLong(1, 1, 510, 0, 27.0), m.MessageInterval)
    assert told.interval_us == -1
    assert s.of(m.RawImu, s.wait(2.0)) == []


def test_each_port_has_its_own_rates(station):
    s = station()
    s.send(m.CommandLong(1, 1, 511, 0, 27.0, 50_000.0), port=3)
    out = [o for o in s.wait(2.0) if isinstance(o.message, m.RawImu)]
    assert sum(o.port == 3 for o in out) == 40
    assert sum(o.port == 0 for o in out) == 2


def test_data_streams_are_set_by_group(station):
    s = station("copter")
    assert s.of(m.Attitude, s.wait(2.0)) == []
    s.send(m.RequestDataStream(1, 1, 10, 5, 1))
    assert len(s.of(m.Attitude, s.wait(2.0))) == 10
    s.send(m.RequestDataStream(1, 1, 0, 5, 0))
    assert s.of(m.Attitude, s.wait(2.0)) == []


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ((511, 12345.0, 1e6), 2),  # an unknown message, as a stream
        ((512, 12345.0), 4),  # and once
        ((31000,), 3),  # an unknown command
        ((176, 1.0, 99.0), 4),  # an unknown mode
        ((246, 1.0), 4),  # armed, it does not restart
        ((42424, 0.0), 4),  # nor calibrate its compasses
    ],
)
def test_what_it_does_not_do_is_answered(station, command, answer):
    assert station().command(*command) == answer


def test_version_and_capabilities_come_on_request(station):
    s = station()
    (version,) = s.ask(m.CommandLong(1, 1, 512, 0, 148.0), m.AutopilotVersion)
    assert version.flight_sw_version >> 8 == 4 << 16 | 6 << 8 | 3
    assert len(s.ask(m.CommandLong(1, 1, 520, 0, 1.0), m.AutopilotVersion)) == 1


def test_commands_for_others_are_left_alone(station):
    s = station()
    assert s.ask(m.CommandLong(7, 1, 400, 0, 0.0), m.CommandAck) == []
    assert s.ask(m.CommandLong(1, 154, 400, 0, 0.0), m.CommandAck) == []
    assert s.vehicle.firmware.status.armed


def test_command_int_is_understood(station):
    s = station()
    acks = s.ask(m.CommandInt(1, 1, 0, 511, 0, 0, 27.0, 100_000.0), m.CommandAck)
    assert [(a.command, a.result) for a in acks] == [(511, 0)]


# --- modes -----------------------------------------------------------------------------------------


def test_modes_are_set_by_both_messages(station):
    s = station()
    assert s.command(176, 1.0, 4.0) == 0
    assert s.vehicle.firmware.reports.heartbeat().custom_mode == 4
    (ack,) = s.ask(m.SetMode(1, 1, 15), m.CommandAck)
    assert (ack.command, ack.result) == (11, 0)
    assert s.vehicle.firmware.reports.heartbeat().custom_mode == 15


def test_guided_needs_a_position(station):
    s = station(armed=False, ready_s=10.0)
    s.wait(1.0)
    assert s.command(176, 1.0, 15.0) == 4
    s.wait(10.0)
    assert s.command(176, 1.0, 15.0) == 0


# --- arming ----------------------------------------------------------------------------------------


def test_a_good_rover_arms_and_disarms(station):
    s = on_the_ground(station, calibration="exact")
    assert s.command(400, 1.0) == 0
    s.wait(1.1)
    assert [b for b in s.of(m.Heartbeat) if b.autopilot == 3][-1].base_mode == 137
    assert s.command(400, 0.0) == 0
    assert s.texts()[-2:] == ["Throttle armed", "Throttle disarmed"]


def test_arming_in_the_first_seconds_and_without_position_is_refused(station):
    assert refusal(station(armed=False)) == "Arm: Accels inconsistent"
    s = station("copter", armed=False, ready_s=30.0, parameters={"ARMING_CHECK": 0.0})
    s.wait(5.0)
    assert refusal(s) == "Arm: AHRS: EK3 sources require GPS"


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        (FieldCorrection((170.0, -30.0, 20.0)), FINE, "Check mag field (xy diff:"),
        (FieldCorrection((50.0, -30.0, 260.0)), FINE, "Check mag field (z diff:"),
        (FieldCorrection((300.0, 150.0, 20.0)), FINE, "Compasses inconsistent"),
        (IDENTITY, IDENTITY, "Compass not calibrated"),
        (FieldCorrection((2000.0, 0.0, 0.0)), FINE, "Compass offsets too high"),
        (FieldCorrection((50.0, -30.0, -400.0)), FINE, "Check mag field: "),
    ],
)
def test_bad_compasses_are_refused_in_the_firmwares_words(station, first, second, text):
    s = on_the_ground(station, compasses=compasses(first, second, FINE), start_yaw_deg=20.0)
    assert refusal(s).startswith(f"Arm: {text}")


def test_a_pure_yaw_error_passes_the_check_against_the_world(station):
    """The check turns the field by the very yaw that came from the compass."""
    calibrated = FieldCorrection((0.0, 0.0, 0.1))
    clean = [CompassSetup(CompassModel(IDENTITY, 1.0), calibrated)] * 3
    s = on_the_ground(station, compasses=clean)
    s.set("COMPASS_ORIENT", 1.0)  # 45 degrees
    s.command(246, 1.0)
    s.wait(8.0)
    assert abs(s.ekf_error_deg) == pytest.approx(45.0, abs=3.0)
    s.command(176, 1.0, 15.0)
    assert s.command(400, 1.0) == 0


@pytest.mark.parametrize("way", ["threshold", "force", "check", "use"])
def test_a_distorted_compass_can_be_armed_with(station, way):
    bad = FieldCorrection((170.0, -30.0, 20.0))
    extra = {"threshold": {"ARMING_MAGTHRESH": 0.0}, "check": {"ARMING_CHECK": 2.0}}
    extra["use"] = {"COMPASS_USE": 0.0}
    s = on_the_ground(
        station, compasses=compasses(bad, FINE, FINE), parameters=extra.get(way), start_yaw_deg=20.0
    )
    assert s.command(400, 1.0, 21196.0 if way == "force" else 0.0) == 0


def test_prearm_reasons_are_repeated_every_half_minute(station):
    bad = compasses(FieldCorrection((170.0, -30.0, 20.0)), FINE, FINE)
    s = on_the_ground(station, compasses=bad, start_yaw_deg=20.0)
    s.wait(70.0)
    assert sum(t.startswith("PreArm: Check mag field") for t in s.texts()) == 2


# --- reboot ----------------------------------------------------------------------------------------


def test_reboot_restarts_the_clock_the_rates_and_the_filter(station):
    s = on_the_ground(station, calibration="exact")
    s.stream(30, 20)
    s.wait(5.0)
    assert s.command(246, 1.0) == 0
    assert s.wait(1.0) == []
    s.wait(4.0)
    s.heard.clear()
    s.wait(3.0)
    attitude = s.of(m.Attitude)
    assert attitude[-1].time_boot_ms < 8000
    assert len(attitude) == 3
    assert s.vehicle.boots == 1


def test_the_steering_compass_is_chosen_at_power_up(station):
    bad = compasses(FieldCorrection((-80.0, 60.0, 20.0)), FINE, FINE)
    s = on_the_ground(station, compasses=bad, start_yaw_deg=90.0)
    bent = s.ekf_error_deg
    assert abs(bent) > 20.0
    s.set("COMPASS_USE", 0.0)
    s.wait(20.0)
    assert s.ekf_error_deg == pytest.approx(bent, abs=8.0)
    s.command(246, 1.0)
    s.wait(5.0)
    assert abs(s.ekf_error_deg) < 3.0


# --- calibration commands --------------------------------------------------------------------------


def test_fixed_yaw_calibration_with_the_true_yaw_cures_hard_iron(station):
    s = station(seed=4, compasses=compasses(FieldCorrection((150.0, 0.0, 0.0)), FINE, FINE), tilt_deg=0.0)
    assert heading_error_rms_deg(s.vehicle) > 15.0
    assert s.command(42006, s.turned_deg % 360.0) == 0
    assert heading_error_rms_deg(s.vehicle) < 1.0
    assert {e.param_id for e in s.of(m.ParamValue)} >= {"COMPASS_OFS_X", "COMPASS_OFS3_Z", "COMPASS_ODI_Y"}


def test_fixed_yaw_calibration_passes_over_compasses_not_in_use(station):
    s = station(compasses=compasses(FieldCorrection((150.0, 0.0, 0.0)), FINE, FINE))
    s.set("COMPASS_USE", 0.0)
    assert s.command(42006, s.turned_deg % 360.0) == 0
    assert s.read("COMPASS_OFS_X") == 150.0


def test_fixed_yaw_calibration_obeys_its_mask(station):
    s = station(compasses=compasses(FieldCorrection((150.0, 0.0, 0.0)), FINE, FINE))
    before = s.read("COMPASS_OFS_X")
    assert s.command(42006, s.turned_deg % 360.0, 2.0) == 0
    assert s.read("COMPASS_OFS_X") == before
    assert s.read("COMPASS_OFS2_X") == pytest.approx(50.0, abs=8.0)


@pytest.mark.parametrize("commit", [(241, (0.0, 76.0)), (242, (2.0, 50.0, -30.0, 20.0))])
def test_a_missing_device_id_is_committed_by_command_only(station, commit):
    s = on_the_ground(
        station,
        compasses=compasses(FINE, FINE, FINE),
        parameters={"COMPASS_DEV_ID": 0.0, "COMPASS_PRIO1_ID": 97539.0},
    )
    s.set("COMPASS_OFS_X", 50.5)
    assert refusal(s) == "Arm: Compass not calibrated"
    number, params = commit
    assert s.command(number, *params) == 0
    assert s.command(400, 1.0) == 0


def test_the_firmwares_own_calibration_blocks_arming(station):
    s = on_the_ground(station, calibration="exact")
    assert s.command(42424, 0.0) == 0
    assert refusal(s) == "Arm: Compass calibration running"
    s.wait(2.0)
    assert {p.compass_id for p in s.of(m.MagCalProgress)} == {0, 1, 2}
    assert s.command(42426, 0.0) == 0
    assert refusal(s) == "Arm: Compass calibrated requires reboot"
    s.command(246, 1.0)
    s.wait(8.0)
    s.command(176, 1.0, 15.0)
    assert s.command(400, 1.0) == 0


# --- telemetry -------------------------------------------------------------------------------------


def test_the_gyro_integrates_to_the_angle_really_turned(station):
    s = station(seed=6)
    s.stream(27, 40)
    s.wait(0.5)
    s.heard.clear()
    before = s.vehicle.truth.yaw_rad
    s.hold_heading(s.vehicle.filter.yaw_rad + math.pi / 2, 3.0)
    imu = s.of(m.RawImu)
    t = np.array([i.time_usec for i in imu]) * 1e-6
    rate = np.array([i.zgyro for i in imu]) * 1e-3
    angle = math.degrees(np.trapezoid(rate, t))
    truth = math.degrees((s.vehicle.truth.yaw_rad - before) % (2 * math.pi))
    assert angle == pytest.approx(truth, abs=1.0)


def test_the_clock_tells_utc_and_time_since_boot(station):
    s = station(utc_start_s=1_780_000_000.0)
    s.stream(2, 10)
    s.wait(1.0)
    told = s.of(m.SystemTime)[-1]
    assert told.time_unix_usec == pytest.approx(1_780_000_001e6, abs=0.2e6)
    assert told.time_boot_ms == pytest.approx(61_000, abs=200)


def test_place_and_heading_are_the_filters(station):
    s = station(place=(47.4, 8.55, 500.0), seed=2)
    s.stream(33, 10)
    s.wait(0.5)
    told = s.of(m.GlobalPositionInt)[-1]
    assert (told.lat, told.lon) == (pytest.approx(474_000_000, abs=50), pytest.approx(85_500_000, abs=50))
    assert told.alt == pytest.approx(500_000, abs=100)
    assert told.hdg == pytest.approx(math.degrees(s.vehicle.filter.yaw_rad) % 360.0 * 100.0, abs=2)


@pytest.mark.parametrize("vehicle", ["rover", "copter"])
def test_every_message_can_be_requested(station, vehicle):
    from mavcompass.simulation.autopilot.telemetry import MESSAGES

    s = station(vehicle)
    for number, (kind, _) in MESSAGES.items():
        s.send(m.CommandLong(1, 1, 512, 0, float(number)))
        heard = s.of(kind, s.wait(0.1))
        assert heard or kind in (m.FenceStatus, m.EstimatorStatus), kind  # the latter is PX4's


def test_highres_imu_carries_a_thousand_times_milligauss(station):
    s = station(seed=2)
    s.stream(27, 10)
    s.stream(105, 10)
    s.wait(0.55)
    raw, highres = s.of(m.RawImu)[-1], s.of(m.HighresImu)[-1]
    assert highres.xmag / 1000.0 == pytest.approx(raw.xmag, abs=1.0)
    assert highres.zacc == pytest.approx(raw.zacc * 9.80665e-3, abs=0.02)


def test_the_order_of_compasses_changes_at_the_next_power_up(station):
    s = on_the_ground(station, calibration="exact")
    for number in (27, 116):
        s.stream(number, 5)
    first, second = s.read("COMPASS_PRIO1_ID"), s.read("COMPASS_PRIO2_ID")
    s.set("COMPASS_OFS2_X", s.read("COMPASS_OFS2_X") + 100.0)
    s.set("COMPASS_PRIO1_ID", second)
    s.set("COMPASS_PRIO2_ID", first)
    s.wait(1.0)
    before = s.of(m.RawImu)[-1]
    s.command(246, 1.0)
    s.wait(4.0)
    for number in (27, 116):
        s.stream(number, 5)
    s.wait(1.0)
    assert s.of(m.RawImu)[-1].xmag - before.xmag == pytest.approx(100.0, abs=12.0)
    assert s.of(m.ScaledImu2)[-1].xmag == pytest.approx(before.xmag, abs=8.0)
