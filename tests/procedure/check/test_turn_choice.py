"""Who turns the vehicle for a check, and what is said where nobody does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.earth_field import earth_field
from mavcompass.enums import MavModeFlag
from mavcompass.errors import Refused
from mavcompass.procedure.check import CheckSettings, preflight
from mavcompass.procedure.check.preflight import _Checker
from mavcompass.procedure.script import Context, Machine, Tick
from mavcompass.procedure.vehicle_state import VehicleState


@pytest.fixture(autouse=True)
def in_manual(monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(desk: Any, motion: str) -> Any:
        def take_charge() -> Any:
            yield desk.context.now
            raise Refused("The vehicle is in MANUAL.", "Switch it.")

        return SimpleNamespace(take_charge=take_charge)

    monkeypatch.setattr(preflight, "Mobility", refusing)


def checker(turn: str, armed: bool = False, kind: str = "rover") -> _Checker:
    desk: Any = SimpleNamespace(
        context=Context(),
        identity=SimpleNamespace(kind=kind, autopilot="ardupilot"),
        state=VehicleState(heartbeat=mav.Heartbeat(base_mode=MavModeFlag.SAFETY_ARMED * armed)),
        parameters={},
        gyro=None,
        rest=None,
    )
    return _Checker(desk, CheckSettings(turn=turn))  # type: ignore[arg-type]


def run(check: _Checker) -> Machine[None]:
    machine = Machine(lambda context: check.turn())
    for tenth in range(5):
        machine.step(Tick(0.1 * tenth))
    assert machine.done
    return machine


@pytest.mark.parametrize(
    ("turn", "armed", "kind", "says"),
    [
        ("auto", False, "rover", None),
        ("vehicle", False, "rover", "No turn was made: it is disarmed."),
        ("hand", True, "rover", "No turn was made: it is armed, and turning it by hand is not safe."),
        ("vehicle", True, "plane", "No turn was made: this ardupilot plane cannot turn on the spot."),
        ("auto", True, "plane", None),
        ("auto", True, "rover", None),  # it refuses, and nobody asked for it
    ],
)
def test_where_nobody_turns_it_that_is_told_to_who_asked(
    turn: str, armed: bool, kind: str, says: str | None
) -> None:
    check = checker(turn, armed, kind)
    machine = run(check)
    assert machine.error is None and not check.turned and check.mover is None
    assert [(i.name, i.verdict, i.text) for i in check.items] == (
        [] if says is None else [("turn", "warn", says)]
    )


@pytest.mark.parametrize(("turn", "armed"), [("vehicle", True), ("hand", False)])
def test_a_turn_that_was_asked_for_and_is_not_safe_is_refused(turn: str, armed: bool) -> None:
    assert isinstance(run(checker(turn, armed)).error, Refused)


def test_the_world_is_that_of_the_place_and_the_date_where_they_are_known() -> None:
    check = checker("none")
    assert check.world() is None
    check.desk.state.place = mav.GlobalPositionInt()
    assert check.world() is None  # nobody is in the Gulf of Guinea without knowing it
    check.desk.state.place = None
    for fix_type, lat, told in ((2, 474_000_000, False), (3, 474_000_000, True), (3, 974_000_000, False)):
        check.desk.state.gps = mav.GpsRawInt(fix_type=fix_type, lat=lat, lon=85_000_000, alt=400_000)
        assert (check.world() is not None) == told
    check.desk.state.place = mav.GlobalPositionInt(lat=474_000_000, lon=85_000_000, alt=400_000)
    undated = check.world()
    assert undated is not None
    assert undated.ned_mgauss == earth_field(47.4, 8.5, 400.0, round(check.settings.year, 2)).ned_mgauss
    for unix_s, year in ((1_798_761_600, 2027.0), (1_399_999_999, round(check.settings.year, 2))):
        check.desk.state.utc = mav.SystemTime(time_unix_usec=unix_s * 1_000_000)
        dated = check.world()
        assert dated is not None and dated.ned_mgauss == earth_field(47.4, 8.5, 400.0, year).ned_mgauss
