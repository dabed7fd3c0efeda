"""Writing what was learnt on the way: nothing moves, nothing is written into what is armed or has changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bent_vehicles import overheard

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavCmd
from mavcompass.errors import Refused
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Machine, Script
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.writing import write_learnt
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink


def what_was_learnt(vehicle: SimulatedAutopilot, **more: Any) -> CalibrationResult:
    setup = vehicle.board.compass_setups[0]
    result = CalibrationResult(1, "running", True, (), setup.model.iron, in_force=setup.in_force)
    return replace(result, heading_sigma_deg=0.2, **more)


class Ground:
    """A disarmed rover, and all that it is sent."""

    def __init__(self, armed: bool = False) -> None:
        self.vehicle = SimulatedAutopilot("rover", seed=3, armed=armed)
        self.heard = overheard(self.vehicle)
        self.saved: list[dict[str, float]] = []

    def writes(
        self, settings: CalibrateSettings, yes: bool = True, arms: bool = False, **more: Any
    ) -> CalibrationReport:
        def save(plan: Any, values: Any, vehicle: Any) -> Path:
            self.saved.append({change.name: change.old for change in plan.changes})
            return Path("undo.json")

        def asked(question: str) -> Any:
            if arms:
                arming = mav.CommandLong(1, 1, MavCmd.COMPONENT_ARM_DISARM, 0, 1.0, 21196.0)
                self.vehicle.receive(arming, 255, 190)
            answers = [None] * 40 if arms else []  # a person takes a while
            return lambda: answers.pop() if answers else yes

        def script(context: Context) -> Script[CalibrationReport]:
            results = [what_was_learnt(self.vehicle, **more)]
            return write_learnt(context, lambda make: make_dialect(make, "sim"), save, results, settings)

        return run(Machine(script), SimulatedLink(self.vehicle), on_ask=asked)

    def rates(self, command: MavCmd = MavCmd.SET_MESSAGE_INTERVAL) -> list[tuple[int, int]]:
        return [
            (int(c.param1), int(c.param2))
            for c in self.heard
            if isinstance(c, mav.CommandLong) and c.command == command
        ]


def test_it_is_asked_written_and_compared_with_the_autopilots_heading() -> None:
    ground = Ground()
    bent_deg = heading_error_rms_deg(ground.vehicle)
    report = ground.writes(CalibrateSettings())
    assert report.written and report.windows == () and report.proof is None
    assert heading_error_rms_deg(ground.vehicle) < 0.05 < bent_deg
    before, *_ = ground.saved  # those after are of what its estimator is told for some seconds
    assert before["COMPASS_OFS_X"] == pytest.approx(report.before[1].offsets_mgauss[0], abs=1e-3)
    assert report.heading is not None and abs(report.heading.error_after_deg) < 2.0
    assert abs(report.heading.error_before_deg) > 10.0
    # It rests for a second and a half, and all of it is recorded.
    assert report.duration_s > 1.5 and np.ptp(report.track.compasses[1].time_s) > 1.5


def test_the_messages_that_tell_the_heading_are_asked_for_and_put_back() -> None:
    ground = Ground()
    ground.writes(CalibrateSettings(rate_hz=20.0))
    asked = {number for number, _ in ground.rates(MavCmd.GET_MESSAGE_INTERVAL)}
    kinds = (mav.RawImu, mav.Attitude, mav.EkfStatusReport, mav.SystemTime, mav.GlobalPositionInt)
    assert {mav.message_id(kind) for kind in kinds} <= asked
    first, last = {}, {}
    for number, interval_us in ground.rates():
        first.setdefault(number, interval_us)
        last[number] = interval_us
    wanted = {mav.RawImu: 20.0, mav.Attitude: 10.0, mav.EkfStatusReport: 2.0, mav.SystemTime: 2.0}
    for kind, hz in wanted.items():
        assert first.get(mav.message_id(kind), round(1e6 / hz)) == round(1e6 / hz)
    assert first and all(last[number] != first[number] for number in first)


def test_a_no_leaves_all_as_it_was_and_compares_nothing() -> None:
    ground = Ground()
    bent_deg = heading_error_rms_deg(ground.vehicle)
    report = ground.writes(CalibrateSettings(), yes=False)
    assert not report.written and report.outcome is None and report.heading is None and ground.saved == []
    assert report.messages[-1] == "Cancelled."
    assert heading_error_rms_deg(ground.vehicle) == bent_deg


def test_who_does_not_ask_writes_and_who_does_not_write_asks_the_vehicle_nothing() -> None:
    ground = Ground()
    assert ground.writes(CalibrateSettings(writing="yes"), yes=False).written
    shy = Ground()
    report = shy.writes(CalibrateSettings(writing="never"))
    assert not report.written and report.plan is None and shy.rates() == [] and shy.saved == []
    assert [result.instance for result in report.results] == [1]


def test_what_is_armed_is_not_written_into_nor_what_arms_before_the_answer() -> None:
    for ground, arms in ((Ground(armed=True), False), (Ground(), True)):
        with pytest.raises(Refused) as refused:
            ground.writes(CalibrateSettings(), arms=arms)
        assert refused.value.what == "The vehicle is armed: what was learnt is written on the ground only."
        assert ground.saved == []


def test_what_was_changed_since_it_was_learnt_is_refused() -> None:
    ground = Ground()
    with pytest.raises(Refused) as refused:
        ground.writes(CalibrateSettings(), in_force=FieldCorrection((1.0, 2.0, 3.0)))
    assert refused.value.what == "The calibration of compass 1 was changed since this was learnt."
