"""Each way to turn, message by message: what is sent, in which units, and where it is limited."""

from __future__ import annotations

import math

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame
from mavcompass.procedure.script import Context, Send
from mavcompass.procedure.turning.pilots_controls import ManualAxis, SteeringOverride, turn_by_controls
from mavcompass.procedure.turning.profiles import known_ways, strategies_for, vehicle_profile
from mavcompass.procedure.turning.steered import Steer, TurnWay
from mavcompass.procedure.turning.ways.guided import AttitudeRate, HeadingAhead, YawRate, YawStep
from mavcompass.procedure.vehicle_state import VehicleState

DEG = math.radians(1.0)


def sent(steer: Steer, rate_deg_s: float = 0.0, left_deg: float = 90.0) -> mav.Message:
    context = Context(system=7, component=3)
    steer.turn(context, rate_deg_s * DEG, left_deg * DEG)
    (action,) = context.outbox
    assert isinstance(action, Send)
    return action.message


def sent_after(steer: Steer) -> list[mav.Message]:
    context = Context(system=7, component=3)
    steer.stand(context)
    steer.let_go(context)
    return [action.message for action in context.outbox if isinstance(action, Send)]


@pytest.mark.parametrize(
    ("rate_deg_s", "pwm"),
    [(0.0, 1500), (45.0, 1750), (90.0, 2000), (135.0, 2000), (-45.0, 1250), (-90.0, 1000), (-999.0, 1000)],
)
@pytest.mark.parametrize("channel", [1, 4])
def test_a_steering_channel_is_moved_alone(channel: int, rate_deg_s: float, pwm: int) -> None:
    """0 would give a channel back to the pilot, 65535 leaves it as it is."""
    untouched = {f"chan{n}_raw": 65535 for n in range(1, 9)}
    mine = f"chan{channel}_raw"
    steer = SteeringOverride(channel)
    assert sent(steer, rate_deg_s) == mav.RcChannelsOverride(7, 3, **untouched | {mine: pwm})
    assert sent_after(steer) == [
        mav.RcChannelsOverride(7, 3, **untouched | {mine: 1500}),
        mav.RcChannelsOverride(7, 3, **untouched | {mine: 0}),
    ]


@pytest.mark.parametrize(
    ("rate_deg_s", "share"),
    [(0.0, 0), (45.0, 500), (90.0, 1000), (180.0, 1000), (-9.0, -100), (-99.0, -1000)],
)
def test_a_stick_goes_to_its_thousandths(rate_deg_s: float, share: int) -> None:
    assert sent(ManualAxis(), rate_deg_s) == mav.ManualControl(7, y=share)
    assert sent(ManualAxis("r", 500), rate_deg_s) == mav.ManualControl(7, z=500, r=share)
    assert sent_after(ManualAxis("r", 500)) == [mav.ManualControl(7, z=500)]
    assert sent_after(ManualAxis()) == [mav.ManualControl(7)]


@pytest.mark.parametrize(
    ("kind", "by", "steer"),
    [("rover", "rc-override", SteeringOverride(1)), ("boat", "rc-override", SteeringOverride(1)),
     ("sub", "rc-override", SteeringOverride(4)), ("rover", "manual-control", ManualAxis("y", 0)),
     ("boat", "manual-control", ManualAxis("y", 0)), ("sub", "manual-control", ManualAxis("r", 500)),
     ("vtol", "rc-override", SteeringOverride(4)), ("vtol", "manual-control", ManualAxis("r", 500))],
)  # fmt: skip
def test_the_pilots_controls_of_each_vehicle(kind: str, by: str, steer: Steer) -> None:
    turn = turn_by_controls(kind, by)  # type: ignore[arg-type]
    assert turn is not None and turn.steer == steer
    assert turn.way.rate_radps == pytest.approx(40.0 * DEG) and turn.way.coast_s == 0.5 and not turn.arrives
    assert strategies_for(kind, "ardupilot", by=by) == (turn,)  # type: ignore[arg-type]
    assert strategies_for(kind, "px4", by=by) == ()  # type: ignore[arg-type]


@pytest.mark.parametrize("by", ["rc-override", "manual-control"])
def test_the_pilots_controls_turn_no_copter(by: str) -> None:
    assert turn_by_controls("copter", by) is None and strategies_for("copter", "ardupilot", by=by) == ()  # type: ignore[arg-type]


def target(**more: float) -> mav.SetPositionTargetLocalNed:
    return mav.SetPositionTargetLocalNed(target_system=7, target_component=3, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rate_deg_s", "gain_per_s", "ahead_deg"),
    [(25.0, 2.0, 12.5), (-25.0, 2.0, -12.5), (10.0, 1.0, 10.0), (99.0, 2.0, 13.68), (-99.0, 2.0, -13.68)],
)
def test_a_heading_ahead_is_as_far_as_makes_the_rate(
    rate_deg_s: float, gain_per_s: float, ahead_deg: float
) -> None:
    """Of SET_POSITION_TARGET_LOCAL_NED's type_mask all but the yaw is to be ignored: 0x9FF."""
    message = sent(HeadingAhead(gain_per_s), rate_deg_s)
    assert isinstance(message, mav.SetPositionTargetLocalNed)
    assert message.yaw == pytest.approx(ahead_deg * DEG, rel=1e-3)
    assert (message.type_mask, message.coordinate_frame) == (0x9FF, MavFrame.BODY_OFFSET_NED)
    assert sent_after(HeadingAhead()) == [target(type_mask=0x5FF, coordinate_frame=MavFrame.BODY_NED)]


@pytest.mark.parametrize("gain_per_s", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("ends_within_s", [1.0, 1.3, 2.5])
def test_the_heading_named_last_is_one_that_ends_in_time(gain_per_s: float, ends_within_s: float) -> None:
    """Follow it as the vehicle does, after the 0.15 s that its body is late: 5 degrees a second at most."""
    message = sent(HeadingAhead(gain_per_s, ends_within_s), 1000.0)
    assert isinstance(message, mav.SetPositionTargetLocalNed)
    left_rad, step_s = message.yaw, 1e-4
    for _ in range(round((ends_within_s - 0.15) / step_s)):
        left_rad -= gain_per_s * left_rad * step_s
    assert gain_per_s * left_rad <= 5.0 * DEG * 1.001
    assert message.yaw <= 90.0 * DEG


@pytest.mark.parametrize(
    ("steer", "type_mask", "frame", "forward_mps"),
    [
        (YawRate(), 0x5FF, MavFrame.BODY_NED, 0.0),
        (YawRate(0x5C7), 0x5C7, MavFrame.BODY_NED, 0.0),
        (YawRate(0x5C7, 1.5), 0x5C7, MavFrame.BODY_OFFSET_NED, 1.5),
    ],
)
def test_a_rate_is_asked_for_bare_or_at_a_speed(
    steer: YawRate, type_mask: int, frame: MavFrame, forward_mps: float
) -> None:
    asked = target(type_mask=type_mask, coordinate_frame=frame, vx=forward_mps, yaw_rate=-0.25)
    assert sent(steer, -0.25 / DEG) == asked
    assert sent_after(steer) == [target(type_mask=type_mask, coordinate_frame=MavFrame.BODY_NED)]


def test_an_attitude_target_asks_for_the_yaw_rate_and_no_thrust() -> None:
    asked = mav.SetAttitudeTarget(target_system=7, target_component=3, type_mask=0x83, body_yaw_rate=0.5)
    assert sent(AttitudeRate(), 0.5 / DEG) == asked
    still = mav.SetAttitudeTarget(target_system=7, target_component=3, type_mask=0x83)
    assert sent_after(AttitudeRate()) == [still] and still.thrust == 0.0


@pytest.mark.parametrize(
    ("rate_deg_s", "left_deg", "step_deg", "sense"),
    [(51.0, 90.0, 8.0, 1.0), (-51.0, 90.0, 8.0, -1.0), (20.0, 5.0, 5.0, 1.0), (20.0, -3.0, 0.0, 1.0),
     (-5.0, 90.0, 4.25, -1.0)],
)  # fmt: skip
def test_a_yaw_step_is_relative_and_no_farther_than_what_is_left_or_ends_in_time(
    rate_deg_s: float, left_deg: float, step_deg: float, sense: float
) -> None:
    message = sent(YawStep(), rate_deg_s, left_deg)
    assert isinstance(message, mav.CommandLong)
    assert (message.command, message.target_system, message.confirmation) == (MavCmd.CONDITION_YAW, 7, 0)
    told = (message.param1, message.param2, message.param3, message.param4)
    assert told == pytest.approx((step_deg, abs(rate_deg_s), sense, 1.0))
    (held,) = sent_after(YawStep())
    assert isinstance(held, mav.CommandLong)
    assert (held.param1, held.param2, held.param3, held.param4) == pytest.approx((0.0, 30.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("rate_deg_s", "left_deg", "heading_deg"),
    [(36.0, 90.0, 8.8), (-36.0, 90.0, 331.2), (36.0, 12.0, 2.0)],
)
def test_a_yaw_step_may_be_told_as_a_heading_the_shorter_way(
    rate_deg_s: float, left_deg: float, heading_deg: float
) -> None:
    """By the autopilot's own heading, 350 deg: what it aims at may lag behind that by any angle."""
    steer = YawStep(own=VehicleState(attitude=mav.Attitude(yaw=-10.0 * DEG)))
    message = sent(steer, rate_deg_s, left_deg)
    assert isinstance(message, mav.CommandLong)
    assert (message.param1, message.param3, message.param4) == pytest.approx((heading_deg, 0.0, 0.0))
    assert sent(steer, rate_deg_s, 4.0) == sent(YawStep(), rate_deg_s, 4.0)
    assert sent_after(steer) == sent_after(YawStep())


@pytest.mark.parametrize("by_heading", [True, False])
def test_a_sub_whose_aim_lags_is_turned_the_right_way_by_headings_alone(by_heading: bool) -> None:
    """As ArduSub turns: an angle is added to its aim, and it goes the way that lies from its nose."""
    yaw_deg, aim_deg, told = 0.0, -12.0, VehicleState(attitude=mav.Attitude(yaw=0.0))
    for _ in range(20):
        message = sent(YawStep(own=told if by_heading else None), 36.0, 90.0)
        assert isinstance(message, mav.CommandLong)
        sought_deg = message.param1 + (aim_deg if message.param4 else 0.0)
        step_deg = math.copysign(3.6, (sought_deg - yaw_deg + 180.0) % 360.0 - 180.0)
        yaw_deg, aim_deg = yaw_deg + step_deg, aim_deg + step_deg
        told.attitude = mav.Attitude(yaw=yaw_deg * DEG)
    assert yaw_deg == pytest.approx(72.0 if by_heading else -72.0)


@pytest.mark.parametrize(
    ("way", "steer", "arrives"),
    [
        ("heading targets", HeadingAhead(1.25, 2.0), False),
        ("attitude targets", AttitudeRate(), False),
        ("CONDITION_YAW", YawStep(2.0), True),
        ("CONDITION_YAW to headings", YawStep(2.0), True),
        ("yaw rate targets", YawRate(), False),
        ("yaw rate targets at a standstill", YawRate(0x5C7), False),
        ("slow arcs", YawRate(0x5C7, 1.5), False),
    ],
)
def test_a_way_is_built_from_the_numbers_of_a_profile(way: str, steer: Steer, arrives: bool) -> None:
    numbers = TurnWay(way, 0.5, 0.7, 0.4, 1.25, 1.5, 0.9, 2.0)
    turn = known_ways()[way](numbers, None)
    assert turn.steer == steer and turn.arrives is arrives and turn.way is numbers


@pytest.mark.parametrize(
    ("kind", "ackermann", "name", "drift_m"),
    [("rover", False, "rover", 0.0), ("rover", True, "ackermann-rover", 15.0),
     ("boat", True, "steered-boat", 40.0), ("boat", False, "boat", 15.0), ("copter", True, "copter", 0.0)],
)  # fmt: skip
def test_steered_wheels_and_rudders_have_profiles_of_their_own(
    kind: str, ackermann: bool, name: str, drift_m: float
) -> None:
    profile = vehicle_profile(kind, "ardupilot", ackermann)
    assert profile is not None and (profile.name, profile.drift_m) == (name, drift_m)


def test_what_a_profile_leaves_out_is_as_documented() -> None:
    assert TurnWay("w", 0.5) == TurnWay("w", 0.5, 0.6, 0.3, 2.0, 0.0, 0.0)
