"""The restart of an autopilot, message by message: refused, lost, back with other values, at its place."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.enums import EkfFlag, MavCmd, MavResult
from mavcompass.errors import LinkLost, Refused, WriteFailed
from mavcompass.procedure.script import Context, Machine, Send, Show, Tick, nothing
from mavcompass.procedure.writing import restart

WRITTEN: Any = SimpleNamespace(
    values={"COMPASS_OFS_X": 60.0, "COMPASS_OFS_Y": -40.0},
    undo_file=Path("u.json"),
    restore_command="restore u.json",
)


class Autopilot:
    """Be a vehicle whose answers are chosen; `step` is every tenth of a second."""

    def __init__(
        self, armed: bool = False, knew_place: bool = False, held: dict[str, float] | None = None
    ) -> None:
        place = mav.EkfStatusReport(flags=EkfFlag.POS_HORIZ_ABS) if knew_place else None
        values = {**WRITTEN.values, **(held or {})}
        self.state = SimpleNamespace(armed=armed, ekf=place)
        self.asked: list[str] = []
        self.now_s, self.texts, self.commands = 0.0, list[str](), list[int]()
        desk: Any = SimpleNamespace(
            context=Context(),
            state=self.state,
            builder=SimpleNamespace(restarts=0),
            dialect=SimpleNamespace(read_parameters=lambda context, names: self._ask("parameters", values)),
        )
        rates: Any = SimpleNamespace(ask=lambda context, wanted: self._ask("rates", {}))
        self.desk = desk
        self.machine = Machine(lambda context: restart(desk, rates, {}, WRITTEN))
        self.machine.context = desk.context

    def _ask(self, what: str, answer: Any) -> Any:
        self.asked.append(what)
        return nothing(answer)

    def until(self, seconds: float, *said: mav.Message) -> Autopilot:
        waiting = list(said)
        while self.now_s < seconds - 1e-9 and not self.machine.done:
            self.now_s = round(self.now_s + 0.1, 1)
            event = mav.Incoming(self.now_s, 1, 1, waiting.pop(0)) if waiting else Tick(self.now_s)
            for action in self.machine.step(event):
                if isinstance(action, Show):
                    self.texts.append(action.text)
                if isinstance(action, Send):
                    assert isinstance(action.message, mav.CommandLong)
                    self.commands.append(action.message.command)
        return self

    def restarts(self) -> Autopilot:
        self.desk.builder.restarts += 1
        return self


def acknowledged(result: int = MavResult.ACCEPTED) -> mav.CommandAck:
    return mav.CommandAck(int(MavCmd.PREFLIGHT_REBOOT_SHUTDOWN), result)


def test_an_armed_vehicle_is_not_restarted() -> None:
    vehicle = Autopilot(armed=True).until(1.0)
    assert isinstance(vehicle.machine.error, Refused) and vehicle.commands == []


def test_it_goes_down_comes_back_and_has_what_was_written() -> None:
    vehicle = Autopilot().until(0.5, acknowledged())
    assert vehicle.commands == [MavCmd.PREFLIGHT_REBOOT_SHUTDOWN] and vehicle.texts == [
        "Restarting the autopilot."
    ]
    assert vehicle.desk.context.silent_until_s == pytest.approx(60.1, abs=0.2)
    vehicle.until(2.0, mav.Heartbeat())
    assert vehicle.asked == []  # what is heard now may be from before
    vehicle.restarts().until(10.0)
    vehicle.until(10.5, mav.Heartbeat())
    assert vehicle.machine.done and vehicle.machine.error is None and vehicle.asked == ["rates", "parameters"]
    assert vehicle.desk.context.silent_until_s <= 10.5


@pytest.mark.parametrize("result", [MavResult.DENIED, MavResult.FAILED])
def test_a_refusal_is_told(result: int) -> None:
    vehicle = Autopilot().until(1.0, acknowledged(result))
    assert isinstance(vehicle.machine.error, Refused) and "refused to restart" in vehicle.machine.error.what
    assert vehicle.desk.context.silent_until_s <= 1.0


def test_one_that_does_not_come_back_is_lost() -> None:
    vehicle = Autopilot().until(70.0, acknowledged())
    assert isinstance(vehicle.machine.error, LinkLost) and "did not come back" in vehicle.machine.error.what
    assert vehicle.now_s == pytest.approx(0.2 + 2.5 + 60.0, abs=0.4)


def test_one_that_went_on_has_not_restarted() -> None:
    vehicle = Autopilot().until(4.0, acknowledged())
    vehicle.until(4.5, mav.Heartbeat())
    assert isinstance(vehicle.machine.error, Refused) and "did not restart" in vehicle.machine.error.what


@pytest.mark.parametrize(
    ("off", "lost"), [(0.0009, False), (-0.0009, False), (0.0011, True), (-0.0011, True)]
)
def test_other_values_than_were_written_are_told_with_the_way_back(off: float, lost: bool) -> None:
    vehicle = Autopilot(held={"COMPASS_OFS_Y": -40.0 + off}).restarts()
    vehicle.desk.builder.restarts = 0
    vehicle.until(3.0, acknowledged()).restarts().until(4.0, mav.Heartbeat())
    if lost:
        error = vehicle.machine.error
        assert isinstance(error, WriteFailed) and "COMPASS_OFS_Y is not what was written" in error.what
        assert "restore u.json" in error.remedy
    else:
        assert vehicle.machine.done and vehicle.machine.error is None


def test_a_place_that_it_knew_is_waited_for() -> None:
    vehicle = Autopilot(knew_place=True).until(3.0, acknowledged()).restarts().until(4.0, mav.Heartbeat())
    assert not vehicle.machine.done and vehicle.state.ekf is None  # what it knew before says nothing
    vehicle.until(13.0)
    waiting = "The autopilot is back; waiting until it knows its place."
    assert vehicle.texts[1:] == [waiting] and not vehicle.machine.done
    vehicle.state.ekf = mav.EkfStatusReport(flags=EkfFlag.ATTITUDE)
    vehicle.until(14.0)
    assert not vehicle.machine.done
    vehicle.state.ekf = mav.EkfStatusReport(flags=EkfFlag.ATTITUDE | EkfFlag.POS_HORIZ_ABS)
    vehicle.until(15.0)
    assert vehicle.machine.done and vehicle.machine.error is None
