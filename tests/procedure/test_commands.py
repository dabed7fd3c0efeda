"""Commands and message rates, message by message."""

from __future__ import annotations

from typing import Any

import pytest

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavResult
from mavcompass.procedure.commands import MessageRates, command
from mavcompass.procedure.script import Context, Machine, Script, Send, Show, Tick

STEP_S = 0.05


class Vehicle:
    """Answer commands; know the intervals of its messages."""

    def __init__(self, intervals_us: dict[int, int] | None = None, fastest_us: int = 0) -> None:
        self.intervals_us = {} if intervals_us is None else intervals_us
        self.fastest_us, self.heard, self.silent = fastest_us, list[mav.CommandLong](), False
        self.knows = {int(MavCmd.SET_MESSAGE_INTERVAL), int(MavCmd.GET_MESSAGE_INTERVAL)}
        self.loses = 0

    def answers(self, asked: mav.CommandLong) -> list[mav.Message]:
        self.heard.append(asked)
        if self.silent or asked.command not in self.knows:
            return []
        if self.loses:
            self.loses -= 1
            return []
        number = int(asked.param1)
        if asked.command == MavCmd.GET_MESSAGE_INTERVAL:
            return [mav.MessageInterval(message_id=number, interval_us=self.intervals_us.get(number, 0))]
        wanted = int(asked.param2)
        if 0 < wanted < self.fastest_us:
            return [mav.CommandAck(asked.command, MavResult.DENIED)]
        self.intervals_us[number] = wanted
        return [mav.CommandAck(asked.command, MavResult.ACCEPTED)]


def talk(
    script: Any, vehicle: Vehicle, longest_s: float = 120.0
) -> tuple[Any, Machine[Any], list[str], float]:
    machine, shown, now_s = Machine(script), list[str](), 0.0
    waiting: list[mav.Message] = []
    while now_s < longest_s and not machine.done:
        event = mav.Incoming(now_s, 0, 0, waiting.pop(0)) if waiting else Tick(now_s)
        for action in machine.step(event):
            if isinstance(action, Send) and isinstance(action.message, mav.CommandLong):
                waiting += vehicle.answers(action.message)
            if isinstance(action, Show):
                shown.append(action.text)
        now_s += STEP_S
    return machine.result, machine, shown, now_s


def numbers(vehicle: Vehicle, number: MavCmd) -> list[tuple[int, int]]:
    return [(int(c.param1), int(c.param2)) for c in vehicle.heard if c.command == number]


def test_an_answer_that_is_no_answer_counts_as_failed() -> None:
    vehicle = Vehicle()
    vehicle.answers = lambda asked: [mav.CommandAck(asked.command, 77)]  # type: ignore[method-assign]
    assert (
        talk(lambda context: command(context, MavCmd.COMPONENT_ARM_DISARM, 1.0), vehicle)[0]
        == MavResult.FAILED
    )


RAW, ATTITUDE = mav.message_id(mav.RawImu), mav.message_id(mav.Attitude)


def asked(rates: MessageRates, vehicle: Vehicle, **hz: float) -> dict[type[mav.Message], bool]:
    kinds = {"raw": mav.RawImu, "attitude": mav.Attitude}
    result, _, _, _ = talk(lambda context: rates.ask(context, {kinds[k]: v for k, v in hz.items()}), vehicle)
    assert result is not None
    return dict(result)


def restored(rates: MessageRates, vehicle: Vehicle) -> list[str]:
    def script(context: Context) -> Script[None]:
        yield from rates.restore(context)

    return talk(script, vehicle)[2]


def test_rates_are_asked_for_and_put_back_as_they_were() -> None:
    vehicle, rates = Vehicle({RAW: 500_000, ATTITUDE: 0}), MessageRates()
    assert asked(rates, vehicle, raw=25.0, attitude=10.0) == {mav.RawImu: True, mav.Attitude: True}
    assert vehicle.intervals_us == {RAW: 40_000, ATTITUDE: 100_000}
    assert asked(rates, vehicle, raw=50.0)[mav.RawImu]
    assert restored(rates, vehicle) == []
    assert vehicle.intervals_us == {RAW: 500_000, ATTITUDE: 0}
    before = len(vehicle.heard)
    assert restored(rates, vehicle) == [] and len(vehicle.heard) == before  # nothing is left to put back


def test_a_rate_that_was_not_put_back_though_it_was_acknowledged_is_put_back_again() -> None:
    class LateAnswers(Vehicle):
        """Acknowledge a change that the request before it asked for."""

        ignores = 0

        def answers(self, asked: mav.CommandLong) -> list[mav.Message]:
            if asked.command == MavCmd.SET_MESSAGE_INTERVAL and self.ignores:
                self.ignores -= 1
                return [mav.CommandAck(asked.command, MavResult.ACCEPTED)]
            return super().answers(asked)

    vehicle, rates = LateAnswers({RAW: 500_000}), MessageRates()
    assert asked(rates, vehicle, raw=25.0)[mav.RawImu]
    vehicle.ignores = 1
    assert restored(rates, vehicle) == [] and vehicle.intervals_us == {RAW: 500_000}


@pytest.mark.parametrize(
    ("interval_us", "is_enough"), [(40_000, True), (40_700, True), (40_900, False), (-1, False)]
)
def test_what_comes_often_enough_is_left_as_it_is(interval_us: int, is_enough: bool) -> None:
    vehicle, rates = Vehicle({RAW: interval_us}), MessageRates()
    assert asked(rates, vehicle, raw=25.0) == {mav.RawImu: True}
    assert bool(numbers(vehicle, MavCmd.SET_MESSAGE_INTERVAL)) is not is_enough
    restored(rates, vehicle)
    assert vehicle.intervals_us[RAW] == interval_us


@pytest.mark.parametrize(("fastest_us", "set_us"), [(50_000, 80_000), (100_000, 160_000), (200_000, None)])
def test_a_denied_rate_is_halved_twice(fastest_us: int, set_us: int | None) -> None:
    vehicle, rates = Vehicle({RAW: 500_000}, fastest_us), MessageRates()
    assert asked(rates, vehicle, raw=25.0) == {mav.RawImu: set_us is not None}
    assert vehicle.intervals_us[RAW] == (set_us or 500_000)
    tried = [us for _, us in numbers(vehicle, MavCmd.SET_MESSAGE_INTERVAL)]
    assert tried == [40_000, 80_000, 160_000][: 2 if set_us == 80_000 else 3]
    count = len(vehicle.heard)
    restored(rates, vehicle)
    assert (len(vehicle.heard) > count) is (set_us is not None)  # what was denied is as it was


def test_a_vehicle_that_does_not_know_the_command_is_asked_once() -> None:
    vehicle, rates = Vehicle(), MessageRates()
    vehicle.knows = set()
    assert asked(rates, vehicle, raw=25.0, attitude=10.0) == {mav.RawImu: False}
    assert {n for n, _ in numbers(vehicle, MavCmd.SET_MESSAGE_INTERVAL)} == {RAW}
    assert len(numbers(vehicle, MavCmd.GET_MESSAGE_INTERVAL)) == 6


def test_an_interval_that_is_not_told_is_put_back_to_its_default() -> None:
    vehicle, rates = Vehicle({RAW: 500_000}), MessageRates()
    vehicle.knows = {int(MavCmd.SET_MESSAGE_INTERVAL)}
    assert asked(rates, vehicle, raw=25.0)[mav.RawImu]
    restored(rates, vehicle)
    assert vehicle.intervals_us[RAW] == 0


def test_a_lost_answer_is_asked_for_again() -> None:
    vehicle, rates = Vehicle({RAW: 500_000}), MessageRates()
    vehicle.loses = 3
    assert asked(rates, vehicle, raw=25.0)[mav.RawImu] and vehicle.intervals_us[RAW] == 40_000
    restored(rates, vehicle)
    assert vehicle.intervals_us[RAW] == 500_000


def test_a_vehicle_that_has_fallen_silent_is_left_and_that_is_said() -> None:
    vehicle, rates = Vehicle({RAW: 500_000}), MessageRates()
    asked(rates, vehicle, raw=25.0)
    vehicle.silent = True
    assert restored(rates, vehicle) == ["The vehicle no longer answers: its message rates were not put back."]
