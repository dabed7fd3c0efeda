"""A person turns the vehicle: which way, how far, level, hold, and when that is enough."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass.errors import LinkLost, PoorCalibration
from mavcompass.procedure.positions import DwellSettings, Rest
from mavcompass.procedure.positions.movers import HandMover
from mavcompass.procedure.script import Context, Machine, Show, Tick
from mavcompass.procedure.turning import GyroAngle

DEG = math.radians(1.0)


class Person:
    """Hold the vehicle at an angle and a tilt, still for a while."""

    def __init__(self, *visited_deg: float, tilt_deg: float = 0.0) -> None:
        self.gyro, self.still_s, self.heard = GyroAngle(), 0.0, True
        heard_s = Rest().heard_s
        self.rest: Any = SimpleNamespace(heard_s=heard_s, for_s=lambda: self.still_s, why_not="hunting")
        self.mover = HandMover(self.gyro, self.rest, visited_rad=[d * DEG for d in visited_deg])
        self.lean(tilt_deg)
        self.at(visited_deg[-1] if visited_deg else 0.0)
        self.texts: list[str] = []

    def at(self, degrees: float) -> None:
        self.gyro.angle_rad = degrees * DEG

    def lean(self, degrees: float) -> None:
        self.gyro._down = (math.sin(degrees * DEG), 0.0, math.cos(degrees * DEG))

    def runs(self, machine: Machine[Any], until_s: float) -> Machine[Any]:
        now_s = machine.context.now
        while now_s < until_s - 1e-9 and not machine.done:
            now_s = round(now_s + 0.1, 1)
            if self.heard:
                self.rest.heard_s = now_s
            self.texts += [a.text for a in machine.step(Tick(now_s)) if isinstance(a, Show)]
        return machine

    def next(self, step_deg: float = 90.0) -> Machine[Any]:
        return Machine(lambda context: self.mover.next(context, step_deg * DEG, 2))

    def settle(self) -> Machine[Any]:
        return Machine(lambda context: self.mover.settle(context, DwellSettings(settle_s=0.5)))


def test_the_way_is_told_until_it_is_near() -> None:
    person = Person()
    machine = person.runs(person.next(), 1.0)
    person.at(77.9)
    person.runs(machine, 2.0)
    assert not machine.done
    person.at(78.1)
    person.runs(machine, 2.2)
    assert machine.done and machine.error is None
    assert person.texts == ["Turn right 90 deg more.", "Turn right 12 deg more.", "Here."]
    assert person.mover.visited_rad == [0.0]
    person = Person(0.0, 90.0)  # and on round, not back to where it stands
    assert not person.runs(person.next(), 1.0).done and person.texts == ["Turn right 90 deg more."]
    person = Person(0.0, 90.0, 180.0, 270.0)  # all round: to either side of the last, the nearer
    person.at(230.0)
    assert not person.runs(person.next(), 0.2).done and person.texts == ["Turn left 50 deg more."]


def test_rest_anywhere_new_is_a_position() -> None:
    for taken, at in (((0.0,), 45.0), ((0.0, 90.0), 10.0)):  # less than fifty degrees from one of them
        person = Person(*taken)
        person.at(at)
        person.still_s = 9.0
        assert not person.runs(person.next(), 1.0).done
    person = Person(0.0)
    person.at(55.0)
    person.still_s = 1.4
    machine = person.runs(person.next(), 1.0)
    assert not machine.done
    person.still_s = 1.6
    assert person.runs(machine, 1.4).done


def test_a_prompt_that_changes_faster_than_it_can_be_read_is_left_out() -> None:
    person = Person(0.0)
    machine = person.next()
    for k in range(20):
        person.at(2.0 * k)
        person.runs(machine, 0.1 * (k + 1))
    assert person.texts == [f"Turn right {d} deg more." for d in (90, 82, 74, 66, 56)]


def test_a_person_has_three_minutes_and_a_vehicle_that_talks() -> None:
    person = Person(0.0)
    machine = person.runs(person.next(), 200.0)
    assert isinstance(machine.error, PoorCalibration) and "within 180 s" in machine.error.what
    assert machine.context.now == pytest.approx(180.1, abs=0.2)
    mute = Person(0.0)
    mute.heard = False
    machine = mute.runs(mute.next(), 20.0)
    assert isinstance(machine.error, LinkLost) and "for 5 s" in machine.error.what
    assert machine.context.now == pytest.approx(5.2, abs=0.15)


def test_what_is_never_held_still_is_told_why() -> None:
    person = Person(0.0)
    machine = person.runs(person.settle(), 200.0)
    assert isinstance(machine.error, PoorCalibration) and "within 180 s (hunting)" in machine.error.what


@pytest.mark.parametrize(
    ("at", "taken"), [(139.0, False), (141.0, True), (-49.0, False), (-51.0, True), (311.0, False)]
)
def test_a_position_counts_fifty_degrees_from_every_other(at: float, taken: bool) -> None:
    person, context = Person(0.0, 90.0), Context()
    assert person.mover.accept(context, at * DEG) is taken
    said = [a.text for a in context.outbox if isinstance(a, Show)]
    assert said == ["Position 3 is taken." if taken else "The vehicle stood here before: turn it further."]
    assert len(person.mover.visited_rad) == (3 if taken else 2)


def shown(context: Context) -> list[tuple[str, str, dict[str, float]]]:
    return [(a.step, a.text, dict(a.data)) for a in context.outbox if isinstance(a, Show)]


def test_what_a_page_is_told_beside_the_words() -> None:
    person = Person(10.0)
    person.at(40.0)
    machine = person.next()
    (first,) = machine.step(Tick(0.0))
    assert isinstance(first, Show) and first.step == "turn"
    told_of = {name: round(value, 6) for name, value in first.data}
    assert told_of == {"live": 1.0, "turned_deg": 0.0, "remaining": 2.0, "left_deg": 60.0}
    person.at(45.0)
    told = [a for step in range(1, 8) for a in machine.step(Tick(0.1 * step)) if isinstance(a, Show)]
    assert dict(told[0].data)["turned_deg"] == pytest.approx(5.0)
    person.at(95.0)
    (here,) = machine.step(Tick(1.0))
    assert here == Show("turn", "Here.", None, (("cue", 1.0),))
    context = Context()
    assert not person.mover.accept(context, 30.0 * DEG) and person.mover.accept(context, 100.0 * DEG)
    assert [(step, data) for step, _, data in shown(context)] == [
        ("turn", {"cue": 1.0}),
        ("taken", {"cue": 1.0}),
    ]
