"""A simulated vehicle is made ready and follows a profile: message by message, on the vehicle's clock."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame, MavParamType
from mavcompass.errors import NoReply, Refused
from mavcompass.procedure.flying import Profile, follow
from mavcompass.procedure.flying.follow import _Clock
from mavcompass.procedure.modes import PX4_OFFBOARD
from mavcompass.procedure.script import Context, Machine, Send, Show, Tick
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState

TIME = np.arange(0.0, 6.0, 0.1)
ROVER, COPTER = VehicleIdentity(1, 1, "ardupilot", "rover"), VehicleIdentity(1, 1, "ardupilot", "copter")


def profile(kind: str = "rover") -> Profile:
    yaw = 3.0 + 0.1 * TIME
    velocity = np.stack([1.0 + 0.0 * TIME, 0.5 + 0.0 * TIME, -0.2 + 0.0 * TIME], axis=1)
    place = np.stack([TIME, 2.0 * TIME, -5.0 + 0.0 * TIME], axis=1)
    return Profile(kind, TIME, yaw, np.full(TIME.size, 0.1), velocity, place, None, 20.0, None)


def attitude(time_s: float, yaw: float = 0.0) -> mav.Incoming:
    return mav.Incoming(time_s, 1, 1, mav.Attitude(time_boot_ms=round(1000.0 * time_s), yaw=yaw))


def heard(clock: _Clock, time_s: float, yaw: float = 0.0) -> _Clock:
    clock.hear(attitude(time_s, yaw))
    return clock


def sent(actions: Iterable[Any]) -> list[Any]:
    return [a.message for a in actions if isinstance(a, Send)]


def drive(
    machine: Machine[Any], clock: _Clock, until_s: float, from_s: float = 0.0, speed: float = 1.0
) -> list[Any]:
    """Let the vehicle tell its attitude 25 times a second; its clock may run faster than ours."""
    out: list[Any] = []
    for k in range(round((until_s - from_s) / 0.04)):
        now_s = from_s + 0.04 * k
        incoming = mav.Incoming(now_s, 1, 1, mav.Attitude(time_boot_ms=round(1000.0 * speed * now_s)))
        clock.hear(incoming)
        out += [(now_s, action) for action in machine.step(incoming)]
        if machine.done:
            break
    return out


@pytest.mark.parametrize(
    ("autopilot", "rate_hz", "imu_hz", "slow_hz", "attitude_hz"),
    [
        ("ardupilot", 20.0, 20.0, 10.0, 20.0),
        ("ardupilot", 99.0, 50.0, 10.0, 50.0),
        ("px4", 1.0, 5.0, 5.0, 10.0),
    ],
)
def test_rates_are_asked_for_by_the_numbers_of_the_protocol(
    autopilot: str, rate_hz: float, imu_hz: float, slow_hz: float, attitude_hz: float
) -> None:
    slow = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "VFR_HUD", "SERVO_OUTPUT_RAW", "BATTERY_STATUS")
    rates = dict.fromkeys(slow, slow_hz) | {"GPS_RAW_INT": 5.0, "SYS_STATUS": 4.0, "EKF_STATUS_REPORT": 4.0}
    rates |= {"SCALED_PRESSURE": 2.0, "ATTITUDE": attitude_hz}
    rates |= {"RAW_IMU": imu_hz} if autopilot == "ardupilot" else {"SCALED_IMU": imu_hz, "HIGHRES_IMU": 0.0}
    numbers = {getattr(ardupilotmega, f"MAVLINK_MSG_ID_{name}"): hz for name, hz in rates.items()}
    assert follow.flight_rates(rate_hz, autopilot) == numbers


def test_what_drives_is_asked_for_speed_and_rate() -> None:
    context = Context(system=1, component=1)
    follow._target(context, profile(), 20, heard(_Clock(), 1.0, 3.0))
    (target,) = sent(context.outbox)
    forward = math.cos(3.2) + 0.5 * math.sin(3.2)
    assert (target.type_mask, target.coordinate_frame, target.time_boot_ms) == (
        0x5C7,
        MavFrame.BODY_NED,
        1000,
    )
    assert target.vx == pytest.approx(forward) and target.yaw_rate == pytest.approx(0.1 + 0.7 * 0.2)
    assert (target.vy, target.yaw, target.x, target.target_system) == (0.0, 0.0, 0.0, 1)


@pytest.mark.parametrize("still", [True, False])
def test_what_flies_is_asked_for_place_speed_and_yaw(still: bool) -> None:
    context = Context(system=1, component=1)
    follow._target(context, profile("copter"), 20, heard(_Clock(), 1.0), still)
    (target,) = sent(context.outbox)
    assert (target.type_mask, target.coordinate_frame) == (0x1C0, MavFrame.LOCAL_NED)
    assert (target.x, target.y, target.z) == pytest.approx((2.0, 4.0, -5.0))
    speed, rate = ((0.0, 0.0, 0.0), 0.0) if still else ((1.0, 0.5, -0.2), 0.1)
    assert (target.vx, target.vy, target.vz) == pytest.approx(speed) and target.yaw_rate == pytest.approx(
        rate
    )
    assert target.yaw == pytest.approx(3.2 - 2.0 * math.pi)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_targets_follow_each_other_by_the_vehicles_clock_until_the_end(speed: float) -> None:
    clock = heard(_Clock(), 0.0)
    machine = Machine(lambda context: follow._follow(context, profile(), clock))
    actions = drive(machine, clock, 20.0, speed=speed)
    assert machine.done and machine.error is None
    targets = [(t, a.message) for t, a in actions if isinstance(a, Send)]
    assert targets[-1][0] == pytest.approx(5.9 / speed, abs=0.2)
    assert len(targets) == pytest.approx(5.9 / max(0.12, 0.04 * speed), abs=2)
    shown = [a for _, a in actions if isinstance(a, Show)]
    assert [a.text for a in shown] == [f"Flying the recording's motion: {k} of 6 s." for k in (0, 5)]
    assert shown[1].fraction == pytest.approx(5.0 / 5.9, abs=0.04)


def test_a_copter_flies_to_the_begin_and_rests_there_for_four_seconds() -> None:
    state, clock = VehicleState(), heard(_Clock(), 0.0)
    machine = Machine(lambda context: follow._to_the_begin(context, profile("copter"), state, clock))
    drive(machine, clock, 3.0)
    state.local = mav.LocalPositionNed(x=0.0, y=1.5, z=-5.0)  # too far still
    drive(machine, clock, 6.0, 3.0)
    state.local = mav.LocalPositionNed(x=0.0, y=1.4, z=-5.0)
    for k in range(300):  # near, and its nose is not yet where it should be
        clock.hear(attitude(6.0 + 0.04 * k, 3.0 - math.radians(4.2 if k < 25 else 3.8)))
        machine.step(attitude(6.0 + 0.04 * k))
        if machine.done:
            break
    assert machine.done and clock.time_s == pytest.approx(6.0 + 1.0 + 4.0, abs=0.1)


def test_a_copter_that_does_not_come_there_begins_after_forty_seconds() -> None:
    state, clock = VehicleState(), heard(_Clock(), 0.0)
    machine = Machine(lambda context: follow._to_the_begin(context, profile("copter"), state, clock))
    drive(machine, clock, 100.0)
    assert machine.done and clock.time_s == pytest.approx(40.0, abs=0.1)


def test_a_px4_enters_offboard_while_targets_come() -> None:
    state, clock = VehicleState(), heard(_Clock(), 0.0)
    machine = Machine(lambda context: follow._into_offboard(context, profile("copter"), state, clock))
    actions = drive(machine, clock, 1.45)
    assert not machine.done and all(
        isinstance(m, mav.SetPositionTargetLocalNed) and (m.vx, m.vy, m.vz) == (0.0, 0.0, 0.0)
        for m in sent(a for _, a in actions)
    )
    state.heartbeat = mav.Heartbeat(custom_mode=PX4_OFFBOARD)
    later = drive(machine, clock, 1.7, 1.45)
    assert machine.done and machine.error is None
    assert [m.command for m in sent(a for _, a in later) if isinstance(m, mav.CommandLong)] == [
        MavCmd.DO_SET_MODE
    ]


def test_a_px4_that_does_not_enter_offboard_is_asked_six_times() -> None:
    state, clock = VehicleState(), heard(_Clock(), 0.0)
    machine = Machine(lambda context: follow._into_offboard(context, profile("copter"), state, clock))
    actions = drive(machine, clock, 60.0)
    asked = [t for t, a in actions if isinstance(a, Send) and isinstance(a.message, mav.CommandLong)]
    assert isinstance(machine.error, Refused) and "did not enter OFFBOARD" in machine.error.what
    assert len(asked) == 6 and np.diff(asked) == pytest.approx([1.5] * 5, abs=0.1)


def test_its_place_is_waited_for_two_minutes_of_its_clock() -> None:
    state, clock = VehicleState(), _Clock()
    state.texts.append("EKF3 waiting for GPS")
    machine = Machine(lambda context: follow._until_it_knows_its_place(context, ROVER, state, clock))
    for k in range(50):
        machine.step(Tick(0.5 * k))
    assert not machine.done  # nothing was heard: its clock does not go
    drive(machine, clock, 200.0, 30.0, speed=4.0)
    assert isinstance(machine.error, Refused) and "It said: EKF3 waiting for GPS." in machine.error.what
    assert "in 120 s" in machine.error.what and clock.time_s == pytest.approx(120.0 + 120.0, abs=1.5)


PLACE, LOCAL = mav.GlobalPositionInt(), mav.LocalPositionNed()


@pytest.mark.parametrize(
    ("autopilot", "told", "knows"),
    [
        ("ardupilot", {}, False), ("ardupilot", {"ekf": mav.EkfStatusReport(flags=0x1FF)}, True),
        *(("ardupilot", {"ekf": mav.EkfStatusReport(flags=0x1FF & ~bit)}, False) for bit in (1, 2, 16)),
        ("px4", {"place": PLACE, "local": LOCAL}, True), ("px4", {"place": PLACE}, False),
        ("px4", {"local": LOCAL}, False),
    ],
)  # fmt: skip
def test_it_flies_once_its_estimator_has_attitude_speed_and_place(
    autopilot: str, told: dict[str, mav.Message], knows: bool
) -> None:
    state, clock, identity = (
        VehicleState(**told),
        heard(_Clock(), 0.0),
        VehicleIdentity(1, 1, autopilot, "copter"),
    )
    ready = Machine(lambda context: follow._until_it_knows_its_place(context, identity, state, clock))
    ready.step(Tick(0.0))
    assert ready.done is knows and ready.error is None


def test_a_parameter_is_set_as_its_type_and_answered() -> None:
    def answered(value: float) -> mav.ParamSet:
        machine = Machine(lambda context: follow._set(context, {"SIM_X": value}))
        (asked,) = sent(machine.step(Tick(0.0)))
        machine.step(mav.Incoming(0.1, 1, 1, mav.ParamValue(param_id="OTHER")))
        assert not machine.done
        machine.step(mav.Incoming(0.2, 1, 1, mav.ParamValue(param_id="SIM_X")))
        assert machine.done and isinstance(asked, mav.ParamSet)
        return asked

    assert (answered(1.5).param_value, answered(1.5).param_type) == (1.5, MavParamType.REAL32)
    whole = answered(3)
    bits = np.float32(whole.param_value).view(np.int32)
    assert whole.param_type == MavParamType.INT32 and bits == 3


def test_the_parameters_are_told_up_to_the_last() -> None:
    machine = Machine(follow._read_parameters)
    assert isinstance(sent(machine.step(Tick(0.0)))[0], mav.ParamRequestList)
    for k in range(3):
        assert not machine.done
        machine.step(mav.Incoming(0.1 * k + 0.1, 1, 1, mav.ParamValue(param_index=k, param_count=3)))
    assert machine.done and machine.error is None
    quiet = Machine(follow._read_parameters)
    quiet.step(Tick(0.0))
    quiet.step(mav.Incoming(0.1, 1, 1, mav.ParamValue(param_index=0, param_count=3)))
    quiet.step(Tick(1.5))
    assert not quiet.done
    quiet.step(Tick(1.7))
    assert quiet.done and quiet.error is None  # it has told what it tells
    mute = Machine(follow._read_parameters)
    for tenth in range(52):
        mute.step(Tick(0.1 * tenth))
    assert isinstance(mute.error, NoReply)


def test_a_clock_that_stands_still_is_noticed() -> None:
    clock = _Clock()
    assert clock.stands(1e6) is None  # nothing was heard yet
    heard(clock, 3.0)
    assert clock.time_s == 3.0 and clock.stands(22.9) is None and "stands still" in str(clock.stands(23.1))
    clock.hear(mav.Incoming(30.0, 1, 1, mav.Heartbeat()))
    assert clock.stands(30.0) is not None


@pytest.mark.parametrize(("down_m", "takeoff_m"), [(-5.0, 5.0), (0.0, 0.0)])
def test_arming_is_tried_eight_times(
    down_m: float, takeoff_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    class Unready:
        def __init__(self, identity: Any, state: Any, modes: Any, permissions: Any) -> None:
            asked.append(permissions.takeoff_m)
            assert permissions.set_mode and permissions.arm

        def make(self, context: Context) -> Any:
            yield context.now
            raise Refused("The vehicle refused to arm.", "Wait.")

    monkeypatch.setattr(follow, "Readiness", Unready)
    here = profile("copter")
    here.position_m[:, 2] = down_m
    machine = Machine(lambda context: follow._ready(context, COPTER, VehicleState(), here))
    for tenth in range(200):
        machine.step(Tick(0.1 * tenth))
    assert isinstance(machine.error, Refused) and asked == [takeoff_m] * 8
    asked.clear()
    rover = Machine(lambda context: follow._ready(context, ROVER, VehicleState(), profile()))
    rover.step(Tick(0.0))
    assert asked == [0.0]
