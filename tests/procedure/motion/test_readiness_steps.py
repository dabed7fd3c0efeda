"""Making a vehicle ready, message by message: heights, patience, and what is said while it waits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.enums import CopterMode, MavCmd, MavResult
from mavcompass.errors import Refused
from mavcompass.kinds import Kind
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.readiness import Permissions, Readiness
from mavcompass.procedure.script import Context, Machine, Script, Send, Show, Tick
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState

STEP_S = 0.05
TAKEOFF, HOLD, LAND = (4 << 16 | sub << 24 for sub in (2, 3, 6))


class Vehicle:
    """Answer commands at once; arm, climb and land as `does` says."""

    def __init__(
        self, kind: Kind = "copter", autopilot: str = "ardupilot", armed: bool = True, **allowed: Any
    ) -> None:
        self.state, self.now_s = VehicleState(heard_s=0.0), 0.0
        self.identity = VehicleIdentity(1, 1, autopilot, kind)
        self.mode, self.armed = (int(CopterMode.GUIDED) if autopilot == "ardupilot" else HOLD), armed
        self.height_m, self.ground_m, self.climbs_mps, self.lands_in_s = 0.0, 0.0, 1.0, 5.0
        self.result, self.takes_modes, self.arms_after_s = MavResult.ACCEPTED, True, 0.0
        self.refuses_with: tuple[str, ...] = ("Arm: too windy",)
        self.commands: list[tuple[float, mav.CommandLong]] = []
        self.shown: list[str] = []
        self.wanted_m, self.coming_s, self.climbs_in = 0.0, math.inf, 0
        self.tell()
        self.readiness = Readiness(
            self.identity, self.state, ModeKeeper(self.state, autopilot), Permissions(**allowed)
        )

    def tell(self) -> None:
        heartbeat = mav.Heartbeat(base_mode=128 if self.armed else 0, custom_mode=self.mode)
        place = mav.GlobalPositionInt(
            alt=round(1e3 * (self.ground_m + self.height_m)), relative_alt=round(1e3 * self.height_m)
        )
        for message in (heartbeat, place):
            self.state.hear(mav.Incoming(self.now_s, 1, 1, message))

    def says(self, text: str) -> None:
        self.state.hear(mav.Incoming(self.now_s, 1, 1, mav.Statustext(text=text)))

    def take(self, asked: mav.CommandLong) -> None:
        self.commands.append((round(self.now_s, 2), asked))
        if self.result != MavResult.ACCEPTED:
            for text in self.refuses_with:
                self.says(text)
        if asked.command == MavCmd.DO_SET_MODE and self.takes_modes:
            px4 = self.identity.autopilot == "px4"
            main, sub = int(asked.param2), int(asked.param3)
            self.mode = main << 16 | sub << 24 if px4 else main
            if self.mode in (LAND, CopterMode.LAND):
                self.coming_s = self.now_s + self.lands_in_s
        elif asked.command == MavCmd.NAV_TAKEOFF and self.result == MavResult.ACCEPTED:
            self.wanted_m, self.mode = math.inf, self.climbs_in or self.mode
        elif asked.command == MavCmd.COMPONENT_ARM_DISARM:
            if asked.param1 and self.result == MavResult.ACCEPTED:
                self.coming_s = self.now_s + self.arms_after_s
            if not asked.param1:
                self.armed = False

    def does(self, script: Callable[[Context], Script[None]], longest_s: float = 200.0) -> Machine[None]:
        machine, answers = Machine(script), list[mav.Message]()
        began_s = self.now_s
        while not machine.done and self.now_s < began_s + longest_s:
            self.now_s += STEP_S
            if self.wanted_m:
                self.height_m += STEP_S * self.climbs_mps
            if self.now_s >= self.coming_s:
                self.armed, self.coming_s = not self.armed, math.inf
            self.tell()
            event: Any = mav.Incoming(self.now_s, 1, 1, answers.pop(0)) if answers else Tick(self.now_s)
            for action in machine.step(event):
                if isinstance(action, Show):
                    self.shown.append(action.text)
                elif isinstance(action, Send) and isinstance(action.message, mav.CommandLong):
                    self.take(action.message)
                    answers.append(mav.CommandAck(action.message.command, self.result))
        assert machine.done, "it hangs"
        return machine

    def makes_ready(self) -> Machine[None]:
        return self.does(self.readiness.make)

    def is_put_back(self, in_a_hurry: bool = False) -> float:
        began_s = self.now_s
        assert self.does(lambda context: self.readiness.put_back(context, in_a_hurry)).error is None
        return self.now_s - began_s

    def asked(self, command: MavCmd) -> list[mav.CommandLong]:
        return [asked for _, asked in self.commands if asked.command == command]


@pytest.mark.parametrize(
    ("autopilot", "altitude_m", "free"), [("ardupilot", 10.0, 0.0), ("px4", 510.0, math.nan)]
)
def test_a_take_off_names_its_height_as_the_autopilot_counts_it(
    autopilot: str, altitude_m: float, free: float
) -> None:
    """ArduPilot's is above the ground; PX4's above the sea, and what is left open is no number."""
    vehicle = Vehicle(autopilot=autopilot, takeoff_m=10.0)
    vehicle.ground_m = 500.0
    vehicle.tell()
    assert vehicle.makes_ready().error is None
    (asked,) = vehicle.asked(MavCmd.NAV_TAKEOFF)
    told = (asked.param1, asked.param2, asked.param3, asked.param7)
    assert told == pytest.approx((0.0, 0.0, 0.0, altitude_m))
    assert (asked.param4, asked.param5, asked.param6) == pytest.approx((free,) * 3, nan_ok=True)
    assert vehicle.shown == ["Taking off to 10 m."]
    # Up to 93 % of it at 1 m/s, and two seconds to come to rest.
    assert vehicle.now_s == pytest.approx(9.3 + 2.0, abs=0.3)


@pytest.mark.parametrize(("height_m", "takes_off"), [(0.95, True), (1.0, False)])
def test_what_flies_at_a_metre_does_not_take_off(height_m: float, takes_off: bool) -> None:
    vehicle = Vehicle(takeoff_m=5.0)
    vehicle.height_m = height_m
    vehicle.tell()
    assert vehicle.makes_ready().error is None
    assert bool(vehicle.asked(MavCmd.NAV_TAKEOFF)) is takes_off


@pytest.mark.parametrize(("climbs_mps", "is_up"), [(9.4 / 40.0, True), (9.2 / 40.0, False)])
def test_a_climb_has_forty_seconds(climbs_mps: float, is_up: bool) -> None:
    vehicle = Vehicle(takeoff_m=10.0)
    vehicle.climbs_mps = climbs_mps
    error = vehicle.makes_ready().error
    if is_up:
        assert error is None
        return
    assert isinstance(error, Refused) and error.what == "The vehicle did not take off."
    assert vehicle.now_s == pytest.approx(40.1, abs=0.3)
    # What may be in the air all the same is told to land.
    vehicle.is_put_back()
    assert vehicle.shown[-1] == "Landing."


@pytest.mark.parametrize(("climbs_in", "lands"), [(TAKEOFF, True), (HOLD, True), (3 << 16, False)])
def test_a_px4_that_has_not_got_up_lands_unless_a_pilot_flies_it(climbs_in: int, lands: bool) -> None:
    vehicle = Vehicle(autopilot="px4", takeoff_m=10.0)
    vehicle.mode, vehicle.climbs_mps, vehicle.climbs_in = 7 << 16, 0.01, climbs_in
    vehicle.tell()
    assert isinstance(vehicle.makes_ready().error, Refused)
    vehicle.is_put_back()
    assert ("Landing." in vehicle.shown) is lands


def test_a_take_off_that_is_refused_is_not_waited_for_and_says_why() -> None:
    vehicle = Vehicle(takeoff_m=10.0)
    vehicle.result = MavResult.DENIED
    vehicle.says("PreArm: no fence")  # before it was asked
    error = vehicle.makes_ready().error
    assert isinstance(error, Refused)
    assert error.what == "The vehicle did not take off. It said: too windy."
    assert vehicle.now_s < 0.5


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ((), ""),
        (("Not ready",), " It said: Not ready."),
        (("Not ready", "Yaw is unknown"), " It said: Yaw is unknown."),
        (("PreArm: no fence", "Not ready"), " It said: no fence."),
        (("Arm: too windy", "Not ready", "PreArm: no fence", "Arm: too windy"),
         " It said: too windy; no fence."),
    ],
)  # fmt: skip
def test_each_reason_that_it_gives_is_told_once_and_where_it_gives_none_what_it_said_last(
    said: tuple[str, ...], told: str
) -> None:
    vehicle = Vehicle(takeoff_m=10.0)
    vehicle.result, vehicle.refuses_with = MavResult.DENIED, said
    error = vehicle.makes_ready().error
    assert isinstance(error, Refused) and error.what == f"The vehicle did not take off.{told}"


@pytest.mark.parametrize(("arms_after_s", "is_ready"), [(0.0, True), (2.8, True), (3.3, False)])
def test_arming_shows_in_the_heartbeat_within_three_seconds(arms_after_s: float, is_ready: bool) -> None:
    vehicle = Vehicle(armed=False, arm=True)
    vehicle.arms_after_s = arms_after_s
    error = vehicle.makes_ready().error
    (asked,) = vehicle.asked(MavCmd.COMPONENT_ARM_DISARM)
    assert asked.param1 == 1.0 and vehicle.shown == ["Arming."]
    assert vehicle.now_s == pytest.approx(min(arms_after_s, 3.0), abs=0.3)
    if is_ready:
        assert error is None
        vehicle.is_put_back()
        assert [c.param1 for c in vehicle.asked(MavCmd.COMPONENT_ARM_DISARM)] == [1.0, 0.0]
    else:
        assert isinstance(error, Refused) and error.what == "The vehicle refused to arm."
        vehicle.is_put_back()  # it did not arm by us: it is not disarmed
        assert len(vehicle.asked(MavCmd.COMPONENT_ARM_DISARM)) == 1


def test_what_was_armed_by_a_pilot_is_not_disarmed_and_its_mode_not_touched() -> None:
    vehicle = Vehicle()
    assert vehicle.makes_ready().error is None
    vehicle.is_put_back()
    assert vehicle.commands == [] and vehicle.shown == []


@pytest.mark.parametrize(
    ("autopilot", "mode"), [("ardupilot", CopterMode.LAND), ("px4", LAND)], ids=["ardupilot", "px4"]
)
def test_what_took_off_by_us_lands_and_the_landing_is_waited_for(autopilot: str, mode: int) -> None:
    vehicle = Vehicle(autopilot=autopilot, takeoff_m=3.0)
    vehicle.makes_ready()
    assert vehicle.is_put_back() == pytest.approx(5.0, abs=1.0)
    assert not vehicle.armed and "Landing." in vehicle.shown
    (to_land, *_) = vehicle.asked(MavCmd.DO_SET_MODE)
    told = (
        int(to_land.param2) << 16 | int(to_land.param3) << 24 if autopilot == "px4" else int(to_land.param2)
    )
    assert told == mode
    assert not vehicle.asked(MavCmd.COMPONENT_ARM_DISARM)  # it disarms by itself


@pytest.mark.parametrize(("in_a_hurry", "waits_s"), [(True, 3.0), (False, 90.0)])
def test_a_landing_is_waited_for_in_a_hurry_hardly(in_a_hurry: bool, waits_s: float) -> None:
    vehicle = Vehicle(autopilot="px4", takeoff_m=3.0)
    vehicle.makes_ready()
    vehicle.lands_in_s = 1000.0
    assert vehicle.is_put_back(in_a_hurry) == pytest.approx(waits_s, abs=0.7)
    assert vehicle.mode == LAND  # the old mode is not put back: it goes on landing


def test_a_landing_that_is_not_taken_is_a_pilots_to_do() -> None:
    vehicle = Vehicle(takeoff_m=3.0)
    vehicle.makes_ready()
    vehicle.takes_modes, vehicle.result = False, MavResult.DENIED
    assert vehicle.is_put_back() < 7.0
    assert vehicle.shown[-1] == "The vehicle did not take the command to land: land it by hand."


def test_what_a_pilot_took_over_is_left_to_the_pilot() -> None:
    vehicle = Vehicle(takeoff_m=3.0)
    vehicle.makes_ready()
    vehicle.mode, count = int(CopterMode.LOITER), len(vehicle.commands)
    vehicle.tell()
    assert vehicle.is_put_back() < 0.2 and len(vehicle.commands) == count


def test_a_copter_that_disarms_while_it_should_climb_is_given_up_at_once() -> None:
    vehicle = Vehicle(takeoff_m=10.0)
    vehicle.climbs_mps, vehicle.coming_s = 0.01, 3.0
    assert isinstance(vehicle.makes_ready().error, Refused) and vehicle.now_s == pytest.approx(3.1, abs=0.2)


def test_a_mode_that_is_refused_is_told() -> None:
    stubborn = Vehicle(set_mode=True)
    stubborn.mode, stubborn.takes_modes, stubborn.result = int(CopterMode.LOITER), False, MavResult.DENIED
    stubborn.tell()
    error = stubborn.makes_ready().error
    assert isinstance(error, Refused)
    assert error.what == "The vehicle refused the flight mode GUIDED. It said: too windy."
