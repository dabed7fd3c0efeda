"""The guard of a motion: each reason to end it, just inside and just beyond its limit; modes by name."""

from __future__ import annotations

import math

import pytest

from mavcompass import messages as mav
from mavcompass.enums import EkfFlag, MavState
from mavcompass.errors import Refused
from mavcompass.kinds import Kind
from mavcompass.messages import Incoming
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.safety import MotionGuard
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleState

ARMED = mav.Heartbeat(type=10, autopilot=3, base_mode=128, custom_mode=15, system_status=4)
HEALTHY = EkfFlag.ATTITUDE
AT = (470_000_000, 80_000_000)
METRE = 1e7 / 111_319.5  # of latitude, in the message's unit


def place(north_m: float = 0.0, east_m: float = 0.0, height_m: float = 5.0) -> mav.GlobalPositionInt:
    lon = AT[1] + east_m * METRE / math.cos(math.radians(47.0))
    return mav.GlobalPositionInt(
        lat=round(AT[0] + north_m * METRE), lon=round(lon), relative_alt=round(height_m * 1e3)
    )


def sticks(*pwm: int) -> mav.RcChannels:
    return mav.RcChannels(chan1_raw=pwm[0], chan2_raw=pwm[1], chan3_raw=pwm[2], chan4_raw=pwm[3])


CENTRED = sticks(1500, 1500, 1100, 1500)


class Scene:
    """A guard that has begun, and a vehicle that speaks ten times a second."""

    def __init__(self, kind: Kind, *said: mav.Message, ours: frozenset[int] = frozenset()) -> None:
        self.state, self.gyro, self.now_s = VehicleState(), GyroAngle(), 0.0
        modes = ModeKeeper(self.state, "ardupilot")
        self.guard = MotionGuard(self.state, self.gyro, kind, modes, moved_by_us=ours)
        for message in (ARMED, place(), CENTRED, *said):
            self.state.hear(Incoming(0.0, 1, 1, message))
        modes.accept_present()
        self.guard.begin()
        assert self.guard.check(0.0) is None

    def after(self, *messages: mav.Message) -> str | None:
        self.now_s += 0.1
        for message in messages:
            self.state.hear(Incoming(self.now_s, 1, 1, message))
            self.guard.hear(Incoming(self.now_s, 1, 1, message))
        return self.guard.check(self.now_s)


@pytest.mark.parametrize(
    ("kind", "message", "said"),
    [
        ("rover", mav.Heartbeat(base_mode=0, custom_mode=15), "disarmed"),
        ("rover", mav.Heartbeat(base_mode=128, custom_mode=4), "mode was changed to HOLD"),
        ("copter", mav.Heartbeat(base_mode=128, custom_mode=6), "mode was changed to RTL"),
        ("rover", mav.Heartbeat(base_mode=128, custom_mode=15, system_status=MavState.CRITICAL), "failsafe"),
        ("rover", mav.Heartbeat(base_mode=128, custom_mode=15, system_status=MavState.EMERGENCY), "failsafe"),
        ("rover", mav.SysStatus(battery_remaining=10), None),
        ("rover", mav.SysStatus(battery_remaining=9), "battery is at 9 %"),
        ("rover", mav.SysStatus(battery_remaining=0), "battery is at 0 %"),
        ("rover", mav.SysStatus(battery_remaining=-1), None),
        ("rover", mav.EkfStatusReport(flags=HEALTHY), None),
        ("rover", mav.EkfStatusReport(flags=0), "estimate is not healthy"),
        ("rover", mav.EkfStatusReport(flags=HEALTHY | EkfFlag.UNINITIALIZED), "estimate is not healthy"),
        ("rover", mav.EkfStatusReport(flags=HEALTHY | EkfFlag.CONST_POS_MODE), None),
        ("copter", mav.EkfStatusReport(flags=HEALTHY | EkfFlag.CONST_POS_MODE), "lost its position"),
        ("rover", mav.Attitude(roll=math.radians(34.9)), None),
        ("rover", mav.Attitude(roll=math.radians(-35.6)), "tilted by 36 deg"),
        ("rover", mav.Attitude(pitch=math.radians(35.6)), "tilted by 36 deg"),
        # cos 26 cos 26 = cos 36.1
        ("rover", mav.Attitude(roll=math.radians(26.0), pitch=math.radians(-26.0)), "tilted by 36 deg"),
        ("rover", mav.FenceStatus(breach_status=0), None),
        ("rover", mav.FenceStatus(breach_status=1), "geofence"),
        ("rover", place(north_m=-4.9), None),
        ("rover", place(north_m=5.1), "moved 5.1 m away"),
        ("rover", place(east_m=4.9), None),
        ("rover", place(east_m=-5.1), "moved 5.1 m away"),
        ("rover", place(north_m=3.7, east_m=3.7), "moved 5.2 m away"),
        ("rover", place(height_m=0.0), None),
        ("copter", place(north_m=5.1), "circles instead of holding its place"),
        ("copter", place(height_m=1.6), None),
        ("copter", place(height_m=1.5), None),
        ("copter", place(height_m=1.4), "1.4 m above its start, too low"),
        ("rover", sticks(1580, 1500, 1100, 1500), None),
        ("rover", sticks(1581, 1500, 1100, 1500), "moved a stick"),
        ("rover", sticks(1500, 1500, 1100, 1419), "moved a stick"),
        ("rover", sticks(1500, 1500, 65535, 1419), None),  # no receiver
        ("rover", sticks(1500, 1500, 799, 1419), None),
        ("rover", sticks(1500, 1500, 800, 1419), "moved a stick"),
        ("rover", sticks(1500, 1500, 2201, 1419), None),
        ("rover", sticks(1500, 1500, 2200, 1500), "moved a stick"),
    ],
)
def test_a_motion_ends_beyond_each_limit(kind: Kind, message: mav.Message, said: str | None) -> None:
    found = Scene(kind).after(message)
    assert (found is None) if said is None else (found is not None and said in found), found


@pytest.mark.parametrize(
    ("start", "now", "strayed"),
    [(1_799_999_990, -1_799_999_990, False), (-1_799_999_990, 1_799_999_990, False),
     (1_799_999_990, -1_799_990_000, True)],
)  # fmt: skip
def test_the_room_to_move_in_goes_on_beyond_the_date_line(start: int, now: int, strayed: bool) -> None:
    scene = Scene("rover", mav.GlobalPositionInt(lat=-170_000_000, lon=start))
    said = scene.after(mav.GlobalPositionInt(lat=-170_000_000, lon=now))
    assert (said is not None and "m away from where it started" in said) is strayed, said


def test_channels_that_we_move_are_not_the_pilots() -> None:
    ours = Scene("rover", ours=frozenset({1}))
    assert ours.after(sticks(1900, 1500, 1100, 1500)) is None
    assert ours.after(sticks(1900, 1600, 1100, 1500)) == "The pilot moved a stick."


@pytest.mark.parametrize(
    ("kind", "held", "said"),
    [("rover", sticks(1650, 1500, 1100, 1500), False), ("rover", sticks(1651, 1500, 1100, 1500), True),
     ("rover", sticks(1349, 1500, 1100, 1500), True), ("rover", sticks(1500, 1900, 1100, 1900), False),
     ("copter", sticks(1500, 1900, 1100, 1500), True), ("copter", sticks(1500, 1500, 1900, 1500), False),
     ("copter", sticks(1500, 1500, 1100, 1100), True), ("sub", sticks(1900, 1900, 1900, 1500), False),
     ("sub", sticks(1500, 1500, 1500, 1900), True)],
)  # fmt: skip
def test_a_stick_that_is_held_is_no_start(kind: Kind, held: mav.RcChannels, said: bool) -> None:
    if not said:
        Scene(kind, held)
        return
    with pytest.raises(Refused, match="holds a stick"):
        Scene(kind, held)


@pytest.mark.parametrize(("deg_s", "said"), [(199.0, None), (200.0, None), (-201.0, "too fast (-201 deg/s)")])
def test_a_turn_has_its_fastest(deg_s: float, said: str | None) -> None:
    scene = Scene("rover")
    scene.gyro.rate_radps = math.radians(deg_s)
    found = scene.after(ARMED)
    assert (found is None) if said is None else (found is not None and said in found)


def test_silence_is_measured_by_the_rhythm_of_the_link() -> None:
    scene = Scene("rover")
    for _ in range(9):
        assert scene.after(ARMED) is None
    assert scene.guard.silence_limit_s() == 2.0  # too little was heard to know the rhythm
    assert scene.after(ARMED) is None
    assert scene.guard.silence_limit_s() == pytest.approx(0.8)
    for _ in range(60):  # five a second: eight in a row
        scene.now_s += 0.1
        assert scene.after(ARMED) is None
    assert scene.guard.silence_limit_s() == pytest.approx(1.6)
    assert [scene.after() is None for _ in range(17)] == [True] * 16 + [False]
    assert scene.guard.check(scene.now_s + 0.1) == "The vehicle fell silent: the link is lost."


def test_what_our_own_computer_slept_through_is_no_silence() -> None:
    scene = Scene("rover")
    assert scene.guard.check(30.0) is None  # one step counts as 0.2 s
    assert scene.guard.check(60.0) is None


def test_a_mode_that_px4_was_changed_to_is_named() -> None:
    state, px4 = VehicleState(), mav.Heartbeat(base_mode=128, custom_mode=6 << 16)
    modes = ModeKeeper(state, "px4")
    guard = MotionGuard(state, GyroAngle(), "copter", modes)
    state.hear(Incoming(0.0, 1, 1, px4))
    modes.accept_present()
    guard.begin()
    assert guard.check(0.0) is None
    state.hear(Incoming(0.1, 1, 1, mav.Heartbeat(base_mode=128, custom_mode=3 << 16)))
    assert guard.check(0.1) == "The flight mode was changed to POSCTL."


def test_a_failsafe_is_told_by_its_own_words() -> None:
    """As of ArduPilot 4.5.7, whose estimator gives up beside iron that is stronger than the Earth's field."""
    scene = Scene("boat")
    scene.state.hear(Incoming(scene.now_s - 9.0, 1, 1, mav.Statustext(text="Throttle armed")))
    for text in ("EKF variance", "EKF failsafe"):
        scene.state.hear(Incoming(scene.now_s, 1, 1, mav.Statustext(text=text)))
    scene.state.hear(Incoming(scene.now_s, 1, 1, mav.Heartbeat(base_mode=128, custom_mode=4)))
    said = "The flight mode was changed to HOLD. It said: EKF variance; EKF failsafe."
    assert scene.guard.check(scene.now_s + 0.1) == said
