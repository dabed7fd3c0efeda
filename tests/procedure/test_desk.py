"""The desk of a live procedure: which compasses, which messages; who turns the vehicle, in how much room."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.errors import Refused
from mavcompass.kinds import Kind
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.motion import Mobility, Permissions
from mavcompass.procedure.positions import HandMover, Mover, VehicleMover
from mavcompass.procedure.script import Context, Machine, Script, Tick, nothing
from mavcompass.procedure.turning import TurnBy
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState
from mavcompass.track_builder import TrackBuilder


def desk_of(
    instances: tuple[int, ...] = (1, 2, 3),
    autopilot: str = "ardupilot",
    began_s: float = 0.0,
    kind: Kind = "rover",
) -> Desk:
    dialect: Any = SimpleNamespace(instances=lambda parameters, heard: instances)
    identity, builder = VehicleIdentity(1, 1, autopilot, kind), TrackBuilder(autopilot, "rover")
    return Desk(Context(now=100.0), identity, dialect, {}, VehicleState(), builder, began_s)


def test_all_compasses_are_worked_on_where_none_is_named() -> None:
    assert desk_of((1, 2)).chosen(()) == (1, 2)
    assert desk_of((1, 2, 3)).chosen((2, 1)) == (2, 1)


@pytest.mark.parametrize(
    ("present", "sentence"),
    [
        ((1, 2), "The vehicle has no compass 3, 4; it has 2."),
        ((), "The vehicle has no compass 1, 3, 4; it has none."),
    ],
)
def test_a_compass_that_is_not_there_is_refused(present: tuple[int, ...], sentence: str) -> None:
    with pytest.raises(Refused) as refused:
        desk_of(present).chosen((1, 3, 4))
    assert refused.value.what == sentence


def test_the_first_compass_is_always_asked_for_as_it_brings_the_gyro_along() -> None:
    desk = desk_of()
    assert desk.imu_rates((3, 2), 25.0) == {mav.RawImu: 25.0, mav.ScaledImu2: 25.0, mav.ScaledImu3: 25.0}
    assert list(desk.imu_rates((1,), 10.0).items()) == [(mav.RawImu, 10.0)]
    assert list(desk.imu_rates((4,), 10.0)) == [mav.RawImu]  # no message carries a fourth
    assert list(desk_of(autopilot="px4").imu_rates((1, 2), 25.0)) == [mav.ScaledImu, mav.ScaledImu2]
    assert desk_of(began_s=58.0).duration_s() == 42.0


@pytest.mark.parametrize(
    ("autopilot", "kind", "rates_hz"),
    [
        ("ardupilot", "rover", {mav.RawImu: 25.0, mav.EkfStatusReport: 2.0, mav.GpsRawInt: 2.0}),
        ("ardupilot", "copter", {mav.RawImu: 50.0, mav.EkfStatusReport: 2.0, mav.GpsRawInt: 5.0}),
        ("px4", "copter", {mav.ScaledImu: 100.0, mav.LocalPositionNed: 4.0, mav.GpsRawInt: 5.0}),
    ],
)
def test_readings_come_fast_and_what_guards_the_vehicle_as_often_as_it_must(
    autopilot: str, kind: Kind, rates_hz: dict[type[mav.Message], float]
) -> None:
    witness = {mav.ScaledImu2: 10.0, mav.Attitude: 10.0, mav.SystemTime: 2.0}
    guard = dict.fromkeys((mav.GlobalPositionInt, mav.RcChannels, mav.SysStatus, mav.Heartbeat), 4.0)
    desk = desk_of((1, 2), autopilot, kind=kind)
    assert desk.calibration_rates((1,), 25.0) == rates_hz | witness | guard
    assert desk.calibration_rates((1,), 5.0)[mav.ScaledImu2] == 5.0


# --- who turns it -----------------------------------------------------------------------------------------

GUIDED = {"rover": 15, "boat": 15, "copter": 4, "sub": 4}


class Charge:
    """Let a Mobility take charge of a vehicle that stands there, ready, and end."""

    def __init__(
        self, kind: Kind = "rover", armed: bool = True, mode: int | None = None, **wishes: Any
    ) -> None:
        beat = mav.Heartbeat(
            base_mode=128 if armed else 0, custom_mode=GUIDED.get(kind, 0) if mode is None else mode
        )
        place = mav.GlobalPositionInt(lat=470_000_000, lon=80_000_000, relative_alt=5000)
        self.heard = (beat, place)
        self.desk = desk_of(kind=kind)
        self.state = self.desk.state
        self.mobility = Mobility(self.desk, **wishes)

    def taken(self) -> Machine[Any]:
        def script(context: Context) -> Script[Mover]:
            self.desk.context = context
            return self.mobility.take_charge()

        machine = Machine(script)
        machine.step(Tick(0.0))
        assert not machine.done and machine.wake_at_s == 1.0  # it waits for a heartbeat
        for step in range(1, 40):
            for message in self.heard:
                self.state.hear(mav.Incoming(0.1 * step, 1, 1, message))
            machine.step(Tick(0.1 * step))
        assert machine.done or self.mobility.permissions.arm
        return machine


@pytest.mark.parametrize(
    ("motion", "armed", "arms", "who"),
    [("auto", True, False, VehicleMover), ("auto", False, False, HandMover), ("auto", False, True, "arms"),
     ("vehicle", True, False, VehicleMover), ("vehicle", False, False, Refused),
     ("hand", True, True, Refused), ("hand", False, True, HandMover), ("none", True, True, Mover)],
)  # fmt: skip
def test_the_vehicle_turns_itself_where_it_is_armed_or_may_be_and_a_person_else(
    motion: Any, armed: bool, arms: bool, who: Any
) -> None:
    taken = Charge(armed=armed, motion=motion, permissions=Permissions(arm=arms)).taken()
    assert (type(taken.error or taken.result) if taken.done else "arms") == who


def test_what_nobody_knows_how_to_turn_is_refused() -> None:
    error = Charge("plane").taken().error
    assert isinstance(error, Refused)
    assert error.what == (
        "There is no known way in which this ardupilot plane turns itself on the spot, unless it can hover,"
        " and does (ArduPilot: QLOITER)."
    )


@pytest.mark.parametrize(("kind", "takes_s"), [("rover", 0.1), ("copter", 1.6)])
def test_what_hovers_is_to_hold_its_place_before_it_is_turned(kind: Kind, takes_s: float) -> None:
    assert Charge(kind).taken().context.now == pytest.approx(takes_s, abs=0.15)


@pytest.mark.parametrize(
    ("kind", "function", "room_m"),
    [("rover", 0.0, 5.0), ("rover", 26.0, 15.0), ("rover", 25.0, 5.0), ("boat", 0.0, 15.0),
     ("boat", 26.0, 40.0)],
)  # fmt: skip
def test_what_cannot_pivot_has_its_room(kind: Kind, function: float, room_m: float) -> None:
    charge = Charge(kind)
    charge.desk.parameters["SERVO1_FUNCTION"] = function
    (guard,) = charge.taken().context.watches
    for beyond_m in (-0.5, 0.5):
        lat = 470_000_000 + round((room_m + beyond_m) * 1e7 / 111_319.5)
        there = mav.GlobalPositionInt(lat=lat, lon=80_000_000, relative_alt=5000)
        charge.state.hear(mav.Incoming(5.0, 1, 1, there))
        assert (guard(5.0) is not None) == (beyond_m > 0.0)


@pytest.mark.parametrize(
    ("turn_by", "foreign", "halts"),
    [("auto", False, True), ("auto", True, False), ("manual-control", True, True)],
)
def test_in_a_pilots_mode_only_the_pilots_controls_are_given_back(
    turn_by: TurnBy, foreign: bool, halts: bool
) -> None:
    charge = Charge(turn_by=turn_by, mode=0 if turn_by != "auto" else None)
    context = charge.taken().context
    if foreign:
        charge.state.heartbeat = mav.Heartbeat(base_mode=128, custom_mode=10)
    done: list[str] = []
    charge.mobility.mover = SimpleNamespace(  # type: ignore[assignment]
        halt=lambda _: done.append("halt"), release=lambda _: nothing(done.append("release"))
    )
    machine = Machine(lambda _: charge.mobility.end(True))
    machine.step(Tick(5.0))
    assert machine.done and context.watches == []
    if halts:  # whoever was silent then is told again
        context.listeners[-1](mav.Incoming(6.0, 1, 1, mav.Heartbeat()))
    assert done == (["halt", "release", "halt"] if halts else ["release"])
