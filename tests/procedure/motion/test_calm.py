"""A copter is not turned before it holds its place."""

from __future__ import annotations

import math

import pytest

from mavcompass import messages as mav
from mavcompass.errors import Refused
from mavcompass.procedure.motion.mobility import wait_until_calm
from mavcompass.procedure.positions import Rest
from mavcompass.procedure.script import Context, Machine, Script, Show, Tick
from mavcompass.procedure.vehicle_state import VehicleState


def waiting(
    swings_until_s: float = 0.0,
    doubts_until_s: float = 0.0,
    tilts_until_s: float = 0.0,
    wanders_m: float = 0.0,
    grows: float = 1.0,
    lat_deg: float | None = None,
) -> tuple[Machine[float], list[str]]:
    """Let a copter fly off, doubt its compass or tilt until some time; the machine tells how long it waited.

    One that wanders goes to and fro for ever, faster than a copter at rest, each time by `grows` as far:
    north of the equator, or at `lat_deg` to the east.
    """
    state, rest = VehicleState(), Rest()
    shown: list[str] = []

    def script(context: Context) -> Script[float]:
        yield from wait_until_calm(context, state, rest)
        return context.now

    machine = Machine(script)
    for step in range(700):
        time_s = 0.1 * step
        speed_cmps = 120 if time_s < swings_until_s or wanders_m else 3
        north_m = 1.2 * min(time_s, swings_until_s)
        north_m += 0.5 * wanders_m * grows ** (time_s / 6.0) * math.sin(2.0 * math.pi * time_s / 6.0)
        variance = 1.2 if time_s < doubts_until_s else 0.1
        degrees = north_m / 111_319.5
        lat, lon = degrees, 7.0
        if lat_deg is not None:
            lat, lon = lat_deg, 7.0 + degrees / math.cos(math.radians(lat_deg))
        place = mav.GlobalPositionInt(lat=round(1e7 * lat), lon=round(1e7 * lon), vx=speed_cmps)
        state.hear(mav.Incoming(time_s, 1, 1, place))
        state.hear(mav.Incoming(time_s, 1, 1, mav.EkfStatusReport(compass_variance=variance)))
        rest.why_not = "tilting" if time_s < tilts_until_s else ""
        shown += [action.text for action in machine.step(Tick(time_s)) if isinstance(action, Show)]
        if machine.done:
            break
    return machine, shown


def test_one_that_holds_its_place_is_turned_soon() -> None:
    machine, shown = waiting()
    assert machine.result == pytest.approx(1.5, abs=0.2) and not shown


@pytest.mark.parametrize("which", ["swings_until_s", "tilts_until_s"])
def test_one_that_swings_is_waited_for(which: str) -> None:
    machine, shown = waiting(**{which: 12.0})
    assert machine.result == pytest.approx(13.5, abs=0.3)
    assert shown == ["Waiting until the vehicle holds its place."]


def test_one_that_doubts_its_compass_is_waited_for_a_while() -> None:
    assert waiting(doubts_until_s=6.0)[0].result == pytest.approx(7.5, abs=0.3)
    assert waiting(doubts_until_s=60.0)[0].result == pytest.approx(10.0, abs=0.3)


@pytest.mark.parametrize("lat_deg", [None, 0.0, -60.0])
def test_one_that_wanders_about_its_place_holds_it_as_well_as_it_can(lat_deg: float | None) -> None:
    machine, shown = waiting(wanders_m=1.2, lat_deg=lat_deg)
    assert machine.result == pytest.approx(12.0, abs=0.5)
    assert shown[-1] == "The vehicle wanders by 1.2 m; it holds its place so well."


@pytest.mark.parametrize(("wanders_m", "grows"), [(1.2, 1.6), (3.0, 1.0)])
def test_one_that_wanders_wider_and_wider_or_far_does_not(wanders_m: float, grows: float) -> None:
    machine, _ = waiting(wanders_m=wanders_m, grows=grows)
    assert isinstance(machine.error, Refused) and "does not hold its place" in machine.error.what


def test_one_that_never_holds_its_place_is_refused_with_the_way_out() -> None:
    machine, _ = waiting(swings_until_s=100.0)
    assert isinstance(machine.error, Refused) and "--motion hand" in machine.error.remedy


def test_what_is_said_of_the_wait_is_said_once_and_after_two_and_a_half_seconds() -> None:
    assert waiting(doubts_until_s=0.9)[1] == []
    assert waiting(doubts_until_s=1.3)[1] == ["Waiting until the vehicle holds its place."]
    machine, shown = waiting(swings_until_s=100.0)
    assert shown == ["Waiting until the vehicle holds its place."]
    assert isinstance(machine.error, Refused)
    assert machine.error.what == "The vehicle does not hold its place within 40 s."
    assert machine.context.now == pytest.approx(40.1, abs=0.15)
