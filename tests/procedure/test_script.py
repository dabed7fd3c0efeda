"""Scripts and their machine: no clock, no sockets, always a clean end."""

from __future__ import annotations

import pytest

from mavcompass.errors import NoReply, Refused
from mavcompass.messages import CommandAck, CommandLong, Heartbeat, Incoming, Message, ScaledImu, ScaledImu2
from mavcompass.procedure.script import (
    CLEAN_UP_S,
    Answer,
    Ask,
    Context,
    Machine,
    Script,
    Send,
    Show,
    Stop,
    Tick,
    ask,
    expect,
    pause,
    request,
)


def heard(time_s: float, message: Message, system: int = 1) -> Incoming:
    return Incoming(time_s, system, 1, message)


def test_a_script_is_woken_no_earlier_than_it_asked_for() -> None:
    def script(context: Context) -> Script[float]:
        yield from pause(context, 2.0)
        return context.now

    machine = Machine(script)
    for time_s in (0.0, 1.0, 1.9):
        machine.step(Tick(time_s))
        assert not machine.done
        assert machine.wake_at_s == 2.0
    machine.step(Tick(2.0))
    assert machine.done
    assert machine.result == 2.0


def test_a_request_is_repeated_until_answered() -> None:
    def script(context: Context) -> Script[CommandAck]:
        return (yield from request(context, CommandLong(command=400), CommandAck))

    machine = Machine(script)
    assert machine.step(Tick(0.0)) == [Send(CommandLong(command=400))]
    assert machine.step(Tick(0.5)) == []
    assert machine.step(Tick(0.8)) == [Send(CommandLong(command=400))]
    machine.step(heard(0.9, CommandAck(400, 0)))
    assert machine.result == CommandAck(400, 0)


def test_messages_of_other_systems_are_not_the_vehicles() -> None:
    seen: list[Incoming] = []

    def script(context: Context) -> Script[Heartbeat | None]:
        context.system, context.component = 7, 1
        context.listeners.append(seen.append)
        return (yield from expect(context, Heartbeat))

    machine = Machine(script)
    machine.step(heard(0.0, Heartbeat(), system=3))
    assert not machine.done
    machine.step(heard(0.1, Heartbeat(type=10), system=7))
    assert machine.result == Heartbeat(type=10)
    assert [m.system for m in seen] == [7]


def test_the_second_compass_is_not_taken_for_the_first() -> None:
    def script(context: Context) -> Script[ScaledImu | None]:
        return (yield from expect(context, ScaledImu))

    machine = Machine(script)
    machine.step(heard(0.0, ScaledImu2(xmag=2)))
    machine.step(heard(0.1, ScaledImu(xmag=1)))
    assert machine.result == ScaledImu(xmag=1)


def test_a_stop_lets_the_script_put_back_what_it_changed() -> None:
    def script(context: Context) -> Script[None]:
        try:
            yield from pause(context, 100.0)
        finally:
            context.send(CommandLong(command=1))
            yield from expect(context, CommandAck)
            context.show("end", "put back")

    machine = Machine(script)
    machine.step(Tick(0.0))
    assert machine.step(Stop(1.0, "Ctrl-C was pressed.")) == [Send(CommandLong(command=1))]
    assert not machine.done
    assert machine.step(heard(1.2, CommandAck(1))) == [Show("end", "put back")]
    assert machine.done
    assert isinstance(machine.error, Refused)
    assert machine.error.what == "Ctrl-C was pressed."


def test_a_clean_up_that_never_ends_is_ended() -> None:
    def script(context: Context) -> Script[None]:
        try:
            yield from pause(context, 100.0)
        finally:
            yield from pause(context, 1000.0)

    machine = Machine(script)
    machine.step(Tick(0.0))
    machine.step(Stop(1.0, "Stopped by hand."))
    machine.step(Tick(1.0 + CLEAN_UP_S))
    assert not machine.done
    machine.step(Tick(1.1 + CLEAN_UP_S))
    assert machine.done
    assert isinstance(machine.error, Refused)
    assert machine.error.what == "Stopped by hand. What was changed could not all be put back."


def test_a_watch_stops_the_script_once() -> None:
    calls: list[float] = []

    def watch(now: float) -> str | None:
        calls.append(now)
        return "The pilot moved a stick." if now > 1.0 else None

    def script(context: Context) -> Script[None]:
        context.watches.append(watch)
        try:
            yield from pause(context, 10.0)
        finally:
            yield from pause(context, 1.0)

    machine = Machine(script)
    for time_s in (0.0, 0.5, 1.5, 2.0, 2.6):
        machine.step(Tick(time_s))
    assert calls == [0.0, 0.5, 1.5]
    assert str(machine.error) == "The pilot moved a stick."


@pytest.mark.parametrize("who", ["listener", "watch"])
def test_whoever_breaks_beside_a_script_still_has_the_vehicle_put_back(who: str) -> None:
    def breaks(_: object) -> None:
        raise ZeroDivisionError

    def script(context: Context) -> Script[None]:
        (context.listeners if who == "listener" else context.watches).append(breaks)
        try:
            yield from pause(context, 10.0)
        finally:
            context.send(CommandLong(command=1))
            yield from expect(context, CommandAck)

    machine = Machine(script)
    sent = [*machine.step(Tick(0.0)), *machine.step(heard(0.1, Heartbeat()))]
    assert sent == [Send(CommandLong(command=1))]
    assert not machine.done
    machine.step(heard(0.2, CommandAck(1)))
    assert machine.done
    assert isinstance(machine.error, ZeroDivisionError)


def test_a_question_waits_for_its_answer() -> None:
    def script(context: Context) -> Script[bool]:
        return (yield from ask(context, Ask("Write?")))

    machine = Machine(script)
    assert machine.step(Tick(0.0)) == [Ask("Write?")]
    machine.step(Tick(500.0))
    assert not machine.done
    machine.step(Answer(501.0, True))
    assert machine.result is True


def test_an_error_in_a_script_is_the_machines_error() -> None:
    def script(context: Context) -> Script[None]:
        yield 0.5
        raise ZeroDivisionError

    machine = Machine(script)
    machine.step(Tick(0.0))
    with pytest.raises(ZeroDivisionError):
        raise machine.error or AssertionError("no error was kept")
    assert machine.step(Tick(1.0)) == []


def test_an_expected_message_is_waited_for_a_second() -> None:
    machine = Machine(lambda context: expect(context, ScaledImu))
    for time_s in (0.0, 0.5, 0.999):
        machine.step(Tick(time_s))
        assert not machine.done and machine.wake_at_s == 1.0
    machine.step(Tick(1.0))
    assert machine.done and machine.result is None


def test_a_request_is_tried_six_times_each_half_as_patient_again() -> None:
    machine = Machine(lambda context: request(context, CommandLong(), CommandAck))
    asked = [step / 100 for step in range(1200) if machine.step(Tick(step / 100))]
    waits = [0.7 * (1.0 + 0.5 * n) for n in range(6)]
    assert asked == pytest.approx([sum(waits[:n]) for n in range(6)], abs=0.06)
    assert machine.context.now == pytest.approx(9.45, abs=0.06) and isinstance(machine.error, NoReply)
    assert machine.error.what == "The vehicle did not answer a request (6 tries)."


def test_a_second_stop_and_one_at_the_end_change_nothing() -> None:
    def script(context: Context) -> Script[str]:
        try:
            yield from pause(context, 10.0)
        finally:
            yield from pause(context, 1.0)
        return "never"

    machine = Machine(script)
    machine.step(Tick(0.0))
    machine.step(Stop(1.0, "First."))
    machine.step(Stop(1.5, "Second."))
    machine.step(Tick(2.5))
    assert machine.done and isinstance(machine.error, Refused) and machine.error.what == "First."
    assert machine.step(Stop(3.0, "Third.")) == [] and machine.error.what == "First."
