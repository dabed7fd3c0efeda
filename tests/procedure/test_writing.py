"""Writing what a calibration found: refused, asked for, written, taken back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.result import CalibrationResult, Mounting
from mavcompass.correction import FieldCorrection
from mavcompass.procedure.dialect import Change, ParameterPlan, WriteOutcome
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Answer, Ask, Context, Machine, Tick, nothing
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.procedure.writing import Writer
from mavcompass.track import Track

FOUND = FieldCorrection((60.0, -40.0, 25.0))
PLAN = ParameterPlan(
    (Change("COMPASS_OFS_X", 5.0, 60.0), Change("COMPASS_OFS_Y", 0.0, -40.0)), (), ("It is slow.",)
)
OUTCOME = WriteOutcome(True, Path("u.json"), {"COMPASS_OFS_X": 60.0}, restore_command="restore u.json")


def report(**more: Any) -> CalibrationReport:
    result = CalibrationResult(1, "four-positions", True, (), FOUND)
    identity = VehicleIdentity(1, 1, "ardupilot", "rover")
    return replace(CalibrationReport(identity, (result,), {}, Track(), (), 9.0), **more)


class Vehicle:
    def __init__(
        self, plan: ParameterPlan = PLAN, trouble: Exception | None = None, raw: bool = False
    ) -> None:
        self.written: list[ParameterPlan] = []
        self.builder_heard: list[tuple[int, Any]] = []

        def write(context: Any, plan: ParameterPlan, save_undo: Any) -> Any:
            self.written.append(plan)
            if trouble is not None:
                raise trouble
            return nothing(OUTCOME)

        dialect = SimpleNamespace(
            plan=lambda parameters, corrections, turned, reporting: plan,
            write=write,
            raw_rotation=lambda parameters, instance: np.eye(3) if raw else None,
        )
        builder = SimpleNamespace(
            set_correction=lambda i, c: self.builder_heard.append((i, c)),
            turn=lambda i, _: self.builder_heard.append((i, "turned")),
            set_raw=lambda i, *_: self.builder_heard.append((i, "raw")),
        )
        state = SimpleNamespace(reporting={1})
        self.desk: Any = SimpleNamespace(
            context=Context(), parameters={}, dialect=dialect, builder=builder, state=state
        )

    def does(self, script: Any, answer: bool | None = None) -> tuple[Machine[Any], list[Any]]:
        machine = Machine(lambda context: script)
        machine.context = self.desk.context
        actions = machine.step(Tick(1.0))
        if answer is not None:
            actions += machine.step(Answer(2.0, answer))
        return machine, actions


def writer(vehicle: Vehicle, asks: bool = False) -> Writer:
    return Writer(vehicle.desk, lambda plan, values: Path("u.json"), asks)


@pytest.mark.parametrize(
    ("raw", "turned", "heard"),
    [(False, False, [FOUND]), (False, True, ["turned", FOUND]), (True, False, []), (True, True, ["raw"])],
)
def test_what_is_heard_from_now_on_is_corrected_by_it_and_a_raw_reading_stays_raw(
    raw: bool, turned: bool, heard: list[Any]
) -> None:
    vehicle, found = Vehicle(raw=raw), report()
    mounted = replace(found.results[0], mounting=Mounting(turned=np.eye(3) if turned else None))
    vehicle.does(writer(vehicle).write(replace(found, results=(mounted,))))
    assert vehicle.builder_heard == [(1, what) for what in heard]


@pytest.mark.parametrize("yes", [True, False])
def test_a_person_is_asked_with_old_and_new(yes: bool) -> None:
    vehicle = Vehicle()
    machine, actions = vehicle.does(writer(vehicle, asks=True).write(report()), yes)
    (asked,) = [a for a in actions if isinstance(a, Ask)]
    assert asked.question == "Write the new calibration (2 parameters)?"
    assert asked.details == ("COMPASS_OFS_X               5 -> 60", "COMPASS_OFS_Y               0 -> -40")
    assert [line.partition(":")[0] for line in asked.about] == ["Compass 1"]
    assert bool(vehicle.written) is yes and (machine.result.outcome is not None) is yes
    assert ("Cancelled." in machine.result.messages) is not yes


def test_it_is_taken_back_by_the_way_that_the_write_left() -> None:
    vehicle, taken = Vehicle(), []
    outcome = replace(OUTCOME, take_back=lambda context, why: nothing(taken.append(why)))
    machine, _ = vehicle.does(writer(vehicle).take_back(report(plan=PLAN, outcome=outcome), "Not proven."))
    assert machine.done and machine.error is None and taken == ["Not proven."]


def test_what_comes_just_before_the_write_comes_after_the_consent() -> None:
    vehicle, order = Vehicle(), []
    careful = Writer(vehicle.desk, writer(vehicle).save_undo, True, lambda: nothing(order.append("before")))
    vehicle.does(careful.write(report()), False)
    assert order == [] and vehicle.written == []
    vehicle.does(careful.write(report()), True)
    assert order == ["before"] and vehicle.written == [PLAN]


def test_a_report_of_no_compass_is_not_accepted_and_one_that_was_undone_not_written() -> None:
    one = report()
    assert one.accepted and not one.written and not one.steers_off
    assert not replace(one, results=()).accepted
    refused = replace(one.results[0], accepted=False)
    assert not replace(one, results=(one.results[0], refused)).accepted
    assert replace(one, outcome=OUTCOME).written and not replace(one, outcome=OUTCOME, undone=True).written
    assert one.noting("First.").noting("Second.", "Third.").messages == ("First.", "Second.", "Third.")


def test_a_plan_that_is_refused_is_not_written() -> None:
    vehicle = Vehicle(replace(PLAN, refusals=("Offsets of zero.",)))
    machine, _ = vehicle.does(writer(vehicle, asks=True).write(report()))
    assert machine.done and machine.result.outcome is None and vehicle.written == []
    assert machine.result.messages == ("Offsets of zero.", "It is slow.")
