"""Flight modes that are changed and put back, and what a vehicle says of itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.errors import NoVehicle, Refused, UsageError
from mavcompass.printable import printable
from mavcompass.procedure.modes import PX4_OFFBOARD, ModeKeeper, command_mode, mode_name, turning_mode
from mavcompass.procedure.script import Context, Machine, Script, Send, Tick
from mavcompass.procedure.vehicle_state import VehicleState, find_vehicle, find_vehicles, identify


@pytest.mark.parametrize(
    ("kind", "autopilot", "by_controls", "mode"),
    [
        ("rover", "ardupilot", False, 15), ("rover", "ardupilot", True, 0), ("copter", "ardupilot", False, 4),
        ("copter", "ardupilot", True, None), ("sub", "ardupilot", False, 4), ("sub", "ardupilot", True, 19),
        ("plane", "ardupilot", False, None), ("copter", "px4", False, None),
        ("vtol", "ardupilot", False, None), ("vtol", "ardupilot", True, 19), ("vtol", "px4", True, None),
    ],
)  # fmt: skip
def test_the_mode_in_which_a_vehicle_takes_turns(
    kind: Any, autopilot: str, by_controls: bool, mode: int | None
) -> None:
    assert turning_mode(kind, autopilot, by_controls) == mode


def test_modes_have_names_for_a_person() -> None:
    assert mode_name("rover", "ardupilot", 15) == "GUIDED" and mode_name("copter", "ardupilot", 9) == "LAND"
    assert mode_name("rover", "ardupilot", 99) == "mode 99" and mode_name("plane", "ardupilot", 5) == "FBWA"
    of_px4 = [mode_name("copter", "px4", main << 16 | 3 << 24) for main in range(1, 8)]
    assert of_px4 == ["MANUAL", "ALTCTL", "POSCTL", "AUTO", "ACRO", "OFFBOARD", "STABILIZED"]
    assert mode_name("copter", "px4", 9 << 16) == f"mode {9 << 16}" and PX4_OFFBOARD == 6 << 16


@pytest.mark.parametrize(
    ("autopilot", "mode", "main", "sub"),
    [("ardupilot", 15, 15.0, 0.0), ("px4", PX4_OFFBOARD, 6.0, 0.0), ("px4", 4 << 16 | 3 << 24, 4.0, 3.0)],
)
def test_a_mode_is_asked_for_as_its_autopilot_counts(
    autopilot: str, mode: int, main: float, sub: float
) -> None:
    context = Context(system=7, component=1)
    command_mode(context, autopilot, mode)
    assert context.outbox == [Send(mav.CommandLong(7, 1, MavCmd.DO_SET_MODE, 0, 1.0, main, sub))]


def test_what_does_not_know_its_place_is_not_told_to_move() -> None:
    state = VehicleState()
    assert state.speed_mps == 0.0
    state.hear(mav.Incoming(1.0, 1, 1, mav.GlobalPositionInt(vx=300, vy=-400)))
    assert state.speed_mps == pytest.approx(5.0)


def test_while_it_changes_both_modes_are_ours_and_then_the_new_one_alone() -> None:
    state, foreign = VehicleState(heard_s=0.0), list[bool]()
    modes = ModeKeeper(state, "ardupilot")
    for mode in (0, 15, 0):  # somebody has taken it back
        state.heartbeat = mav.Heartbeat(custom_mode=mode)
        if not foreign:
            modes.accept_present()
            Machine(lambda context: modes.change(context, 15)).step(Tick(0.0))
        foreign.append(modes.is_foreign())
    assert foreign == [False, False, True]


# --- what a vehicle says ---------------------------------------------------------------------------------


def heard(time_s: float, message: mav.Message, system: int = 1) -> mav.Incoming:
    return mav.Incoming(time_s, system, 1, message)


ROVER = mav.Heartbeat(type=10, autopilot=3)


@pytest.mark.parametrize(
    ("beat", "told"),
    [
        (ROVER, ("ardupilot", "rover")), (mav.Heartbeat(type=2, autopilot=12), ("px4", "copter")),
        (mav.Heartbeat(type=6, autopilot=8), None),
        (mav.Heartbeat(type=250, autopilot=3), ("ardupilot", "unknown")),
        (mav.Attitude(), None),
    ],
)  # fmt: skip
def test_an_autopilot_is_known_by_its_heartbeat(beat: mav.Message, told: tuple[str, str] | None) -> None:
    found = identify(heard(1.0, beat, 9))
    assert (found and (found.autopilot, found.kind)) == told
    assert found is None or (found.system, found.component) == (9, 1)


def find(
    script: Callable[[Context], Script[Any]], *messages: mav.Incoming | Tick, until_s: float = 20.0
) -> Machine[Any]:
    machine = Machine(script)
    for message in messages:
        machine.step(message)
    for tenth in range(round(10.0 * until_s)):
        machine.step(Tick(5.0 + 0.1 * tenth))
    return machine


def test_the_vehicle_is_the_only_autopilot_or_the_one_asked_for() -> None:
    beats = [heard(0.1, mav.Heartbeat(type=6, autopilot=8), 255), heard(0.2, ROVER, 3), heard(0.3, ROVER, 4)]
    only = find(lambda c: find_vehicle(c), *beats[:2])
    assert only.result.system == 3 and only.context.system == 3 and only.context.alone
    picked = find(lambda c: find_vehicle(c, 4), *beats)
    assert picked.result.system == 4 and not picked.context.alone
    other = find(lambda c: find_vehicle(c, 5, 4.0), *beats)
    assert isinstance(other.error, NoVehicle) and "3 messages were heard" in other.error.what
    assert "with system id 5" in other.error.what
    mute = find(lambda c: find_vehicle(c, None, 7.0))
    assert isinstance(mute.error, NoVehicle) and "Nothing was heard in 7 s" in mute.error.what


@pytest.mark.parametrize("order", [(3, 4), (4, 3)])
def test_of_several_vehicles_none_is_taken_by_chance(order: tuple[int, int]) -> None:
    armed = mav.Heartbeat(type=2, autopilot=12, base_mode=128)
    told = {3: ROVER, 4: armed}
    first, second = order
    machine = find(
        lambda c: find_vehicle(c), heard(0.2, told[first], first), heard(1.3, told[second], second)
    )
    assert isinstance(machine.error, UsageError) and machine.error.exit_code == 2
    assert str(machine.error).splitlines() == [
        "2 vehicles are on this link:",
        "  system 3: rover, ardupilot, disarmed, without a unique id",
        "  system 4: copter, px4, armed, without a unique id",
        " Choose one with --system.",
    ]


def test_two_autopilots_that_beat_with_one_system_id_are_told() -> None:
    for script in (find_vehicle, find_vehicles):
        machine = find(script, heard(0.2, ROVER, 3), heard(0.9, mav.Heartbeat(type=2, autopilot=12), 3))
        assert isinstance(machine.error, Refused)
        assert "Two autopilots share system id 3" in str(machine.error)
        assert "SYSID_THISMAV" in machine.error.remedy


def test_all_vehicles_on_a_link_are_those_of_three_seconds() -> None:
    times = ((0.2, 4), (1.0, 2), (1.2, 4), (3.1, 7), (3.3, 0), (3.4, 9))
    beats = [heard(time_s, ROVER, system) if system else Tick(time_s) for time_s, system in times]
    found = find(lambda c: find_vehicles(c), *beats)
    assert [v.system for v in found.result] == [2, 4, 7]


def test_the_latest_of_what_it_says_is_kept_if_it_can_be() -> None:
    state = VehicleState()
    assert not state.armed and state.mode == -1
    state.hear(heard(1.0, mav.Heartbeat(base_mode=128, custom_mode=15)))
    assert state.armed and state.mode == 15 and state.heard_s == 1.0
    state.hear(heard(2.0, mav.Heartbeat(base_mode=127)))
    assert not state.armed
    good = mav.Attitude(roll=0.1)
    for message in (good, mav.Attitude(roll=math.nan), mav.Attitude(pitch=math.inf)):
        state.hear(heard(3.0, message))
    assert state.attitude is good
    there = mav.GlobalPositionInt(lat=900_000_000, lon=-1_800_000_000)
    for place in (there, mav.GlobalPositionInt(lat=900_000_001), mav.GlobalPositionInt(lon=-(2**31))):
        state.hear(heard(4.0, place))
    assert state.place is there
    local = mav.LocalPositionNed(x=1.0)
    for position in (local, mav.LocalPositionNed(z=math.nan)):
        state.hear(heard(5.0, position))
    assert state.local is local and state.heard_s == 5.0
    for k in range(25):
        state.hear(heard(6.0, mav.Statustext(text=f"text {k}\n\x1b[31m")))
    assert next(iter(state.texts)) == r"text 5\n\x1b[31m" and len(state.texts) == 20
    # A long text of PX4 comes in two pieces, with its mark of what is told as an event, too.
    for piece, text in enumerate(("Arming denied: Resolve system health failures firs", "t\t")):
        state.hear(heard(7.0, mav.Statustext(text=text, id=9, chunk_seq=piece)))
    assert state.texts[-1] == "Arming denied: Resolve system health failures first"
    assert state.said_since(-math.inf) == list(state.texts) and state.said_since(math.inf) == []
    assert printable("é°\t\x1b[2J") == r"é°\t\x1b[2J"
