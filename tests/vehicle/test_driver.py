"""Running a procedure on a link: the happy way, and every way of ending early."""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from dataclasses import replace

import pytest
from dialogue import HEARTBEAT, Expect, MemoryVehicle, Reply, Said, Silence, vehicle_script

from mavcompass.enums import MavType
from mavcompass.errors import LinkLost, NoReply, Refused, WriteFailed
from mavcompass.messages import CommandAck, CommandLong, Heartbeat, Incoming, ParamSet, ParamValue, Statustext
from mavcompass.procedure.script import Ask, Context, Machine, Script, Show, ask, pause, request
from mavcompass.vehicle import stopping
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.faults import Faults, FaultyLink
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.stopping import StopRequest

SET = ParamSet(param_id="COMPASS_OFS_X", param_value=120.0)
ECHO = ParamValue("COMPASS_OFS_X", 120.0)
UNDO = ParamSet(param_id="COMPASS_OFS_X", param_value=5.0)


def write(context: Context) -> Script[float]:
    """Write one parameter and wait for its echo."""
    answer = yield from request(context, SET, ParamValue, lambda v: v.param_id == SET.param_id)
    context.show("write", "Written.", 1.0)
    return answer.param_value


def turn(context: Context) -> Script[None]:
    """Do something long to vehicle 1, and put it right at the end."""
    context.system, context.component = 1, 1
    try:
        context.send(CommandLong(command=115))
        yield from pause(context, 60.0)
    finally:
        context.send(UNDO)
        yield from pause(context, 0.2)


def test_a_procedure_runs_as_the_manual_says() -> None:
    shown: list[Show] = []
    with vehicle_script(Expect(SET), Reply(ECHO)) as link:
        assert run(Machine(write), link, on_show=shown.append) == 120.0
    assert [s.text for s in shown] == ["Written."]


def test_an_unanswered_request_is_repeated() -> None:
    with vehicle_script(Expect(SET), Expect(SET), Reply(ECHO)) as link:
        assert run(Machine(write), link) == 120.0
        assert link.now() == pytest.approx(0.71, abs=0.05)


def test_our_heartbeat_is_heard_every_second_under_the_vehicles_system_id() -> None:
    vehicle = MemoryVehicle(system=7)

    def watch(context: Context) -> Script[None]:
        with context.station():  # as a ground station's, too, for so long
            yield from pause(context, 1.5)
        context.system, context.component = 7, 1
        yield from pause(context, 3.0)

    with SimulatedLink(vehicle) as link:
        run(Machine(watch), link)
    beats = [(*sender, m.type) for *sender, m in vehicle.heard if isinstance(m, Heartbeat)]
    ours, station = MavType.ONBOARD_CONTROLLER, MavType.GCS
    assert beats == [(1, 191, ours)] * 2 + [(1, 191, station)] + [(7, 191, ours)] * 3


def test_what_the_procedure_raises_reaches_the_caller() -> None:
    def fail(context: Context) -> Script[None]:
        yield context.now + 0.1
        raise WriteFailed("Half written.", restore_command="mavcompass params restore")

    with SimulatedLink(MemoryVehicle()) as link, pytest.raises(WriteFailed):
        run(Machine(fail), link)


def test_every_message_can_be_listened_to() -> None:
    vehicle = MemoryVehicle()
    vehicle.say(Statustext(text="hello"), after_s=0.1)
    heard = []

    def wait(context: Context) -> Script[None]:
        yield from pause(context, 0.5)

    with SimulatedLink(vehicle) as link:
        run(Machine(wait), link, on_message=heard.append)
    assert [h.message for h in heard] == [HEARTBEAT, Statustext(text="hello")]


def test_a_question_does_not_stop_the_heartbeat() -> None:
    vehicle = MemoryVehicle()
    asked = []

    def decide(context: Context) -> Script[bool]:
        return (yield from ask(context, Ask("Write?")))

    with SimulatedLink(vehicle) as link:

        def on_ask(question: Ask) -> object:
            asked.append(question)
            return lambda: True if link.now() > 3.2 else None

        assert run(Machine(decide), link, on_ask=on_ask) is True
    assert asked == [Ask("Write?")]
    assert sum(isinstance(m, Heartbeat) for _, _, m in vehicle.heard) == 4


def test_without_anybody_to_ask_the_answer_is_no() -> None:
    def decide(context: Context) -> Script[bool]:
        return (yield from ask(context, Ask("Write?")))

    with SimulatedLink(MemoryVehicle()) as link:
        assert run(Machine(decide), link) is False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_end_the_motion_and_put_back_what_was_changed(number: int) -> None:
    before = signal.getsignal(number)

    def interrupted(context: Context) -> Script[None]:
        context.listeners.append(lambda heard: os.kill(os.getpid(), number) if heard.time_s == 3.0 else None)
        yield from turn(context)

    with vehicle_script(Expect(CommandLong(command=115)), Expect(UNDO)) as link:
        with pytest.raises(Refused, match="Stopped by") as caught:
            run(Machine(interrupted), link)
        assert 3.0 <= link.now() < 3.5
    assert caught.value.exit_code == 7
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_further_signal_interrupts_what_hangs(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "_HANGS_S", 0.05)

    def hang(context: Context) -> Script[None]:
        yield context.now
        while True:
            os.kill(os.getpid(), number)

    with SimulatedLink(MemoryVehicle()) as link, pytest.raises(KeyboardInterrupt):
        run(Machine(hang), link)


@pytest.mark.parametrize(("apart_s", "ending"), [(0.0, Refused), (0.01, WriteFailed)])
def test_ctrl_c_pressed_again_and_again_ends_orderly(
    apart_s: float, ending: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hammering is one press, and the old value is put back; who means it is told what stands."""
    monkeypatch.setattr(stopping, "_ONE_PRESS_S", 0.005 if apart_s else 1.0)
    shown, heard = list[str](), itertools.count()

    def press(context: Context) -> Script[None]:
        context.system, context.component = 1, 1
        try:
            yield from pause(context, 60.0)
        finally:
            try:
                yield from pause(context, 2.0)  # putting back takes its time, and all presses fall into it
            except GeneratorExit:
                raise WriteFailed("1 of 6 parameters is new.", restore_command="...") from None

    def signalled(_: object) -> None:
        if next(heard) % 3 == 0:
            time.sleep(apart_s)
            os.kill(os.getpid(), signal.SIGINT)

    vehicle = MemoryVehicle()
    for number in range(60):
        vehicle.say(Statustext(text=str(number)), after_s=1.0 + 0.01 * number)
    with SimulatedLink(vehicle) as link, pytest.raises(ending) as caught:
        run(Machine(press), link, on_message=signalled, on_show=lambda show: shown.append(show.text))
    assert type(caught.value) is ending
    assert shown == (["Ending safely; once more leaves everything as it stands."] if apart_s else [])


def test_another_thread_can_stop_a_procedure_that_is_not_in_the_main_thread() -> None:
    stop = StopRequest()
    outcome: list[BaseException] = []
    vehicle = MemoryVehicle()

    def work() -> None:
        with SimulatedLink(vehicle, speed=20.0) as link:
            try:
                run(Machine(turn), link, stop=stop)
            except Refused as error:
                outcome.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    stop.reason = "The service is shutting down."
    thread.join(5.0)
    assert [str(error) for error in outcome] == ["The service is shutting down."]
    assert (1, 191, UNDO) in vehicle.heard


def test_a_vehicle_that_falls_silent_is_lost_and_the_undo_is_tried() -> None:
    with vehicle_script(Expect(CommandLong(command=115)), Silence(), Expect(UNDO)) as link:
        with pytest.raises(LinkLost, match="said nothing for 5 s") as caught:
            run(Machine(turn), link)
        assert link.now() < 6.5
    assert caught.value.exit_code == 3 and caught.value.remedy


@pytest.mark.parametrize(("last_s", "lost_s"), [(-1.0, 5.0), (3.0, 8.0)])
def test_silence_counts_from_the_last_message_or_the_beginning(last_s: float, lost_s: float) -> None:
    ended_s = list[float]()

    def listen(context: Context) -> Script[None]:
        context.system, context.component = 1, 1
        try:
            yield from pause(context, 60.0)
        finally:
            ended_s.append(context.now)

    vehicle = MemoryVehicle(beats=False)
    if last_s > 0.0:
        vehicle.say(HEARTBEAT, after_s=last_s)
    with SimulatedLink(vehicle) as link, pytest.raises(LinkLost, match="said nothing for 5 s"):
        run(Machine(listen), link)
    assert ended_s == pytest.approx([lost_s + 0.03], abs=0.04)


@pytest.mark.parametrize(("system", "component"), [(2, 1), (1, 191)])
def test_what_others_say_does_not_keep_a_silent_vehicle_alive(system: int, component: int) -> None:
    class Crowd(MemoryVehicle):
        def advance(self, until_s: float) -> list[Said]:
            mine = [said for said in super().advance(until_s) if said.time_s < 3.0]
            return [*mine, Said(until_s, system, component, HEARTBEAT)]

    vehicle = Crowd()
    with SimulatedLink(vehicle) as link:
        with pytest.raises(LinkLost, match="said nothing for 5 s"):
            run(Machine(turn), link)
        assert 7.0 < link.now() < 8.5


def test_a_computer_that_was_asleep_does_not_take_the_vehicle_for_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slept_s = [0.0]

    def doze(context: Context) -> Script[str]:
        context.system, context.component = 1, 1
        yield from pause(context, 3.0)
        slept_s[0] = 30.0
        yield from pause(context, 40.0)
        return "awake"

    with SimulatedLink(MemoryVehicle()) as link:
        awake = link.now
        monkeypatch.setattr(link, "now", lambda: awake() + slept_s[0])
        assert run(Machine(doze), link) == "awake"


def test_a_link_that_breaks_for_good_ends_the_procedure_at_once() -> None:
    vehicle = MemoryVehicle()
    with FaultyLink(SimulatedLink(vehicle), Faults(cut_at_s=5.0, cut_is_final=True), seed=0) as link:
        with pytest.raises(LinkLost, match="cut"):
            run(Machine(turn), link)
        assert link.now() == pytest.approx(5.0)
    assert (1, 191, UNDO) not in vehicle.heard


def test_a_torn_write_is_told_rather_than_the_lost_link() -> None:
    def torn(context: Context) -> Script[None]:
        context.system, context.component = 1, 1
        try:
            yield from pause(context, 60.0)
        except Refused as stop:
            raise WriteFailed("2 of 6 parameters are new.", restore_command="...") from stop

    with FaultyLink(SimulatedLink(MemoryVehicle()), Faults(cut_at_s=5.0, cut_is_final=True), seed=0) as link:
        with pytest.raises(WriteFailed):
            run(Machine(torn), link)


def test_a_lossy_slow_link_only_takes_longer() -> None:
    class Obedient(MemoryVehicle):
        def receive(self, message: object, system: int, component: int, port: int = 0) -> None:
            if isinstance(message, CommandLong):
                self.say(CommandAck(command=message.command))

    def many(context: Context) -> Script[int]:
        for command in range(30):
            ack = CommandAck(command=command)
            yield from request(
                context, CommandLong(command=command), CommandAck, lambda a, ack=ack: a == ack, tries=12
            )
        return 30

    faults = Faults(loss=0.3, duplicate=0.05, reorder=0.1, latency_s=0.3)
    times = []
    for seed in (1, 1, 2):
        with FaultyLink(SimulatedLink(Obedient()), faults, seed) as link:
            assert run(Machine(many), link) == 30
            times.append(link.now())
    assert times[0] == times[1] != times[2], "the same seed gives the same faults"
    assert times[0] > 30 * 0.6


def test_an_answer_that_a_flood_drowns_is_not_put_down_to_a_weak_radio() -> None:
    class Flooded(SimulatedLink):
        def behind_s(self) -> float:
            return 4.0

    with pytest.raises(NoReply) as caught:
        run(Machine(write), Flooded(MemoryVehicle(), "udpin:flooded"))
    assert "more has come on udpin:flooded than this computer could read" in caught.value.remedy
    with pytest.raises(NoReply, match="radios"):
        run(Machine(write), SimulatedLink(MemoryVehicle(), "sim:mute"))


def test_a_message_that_has_waited_does_not_turn_time_back() -> None:
    times: list[float] = []

    class Late(SimulatedLink):
        """Give each message as late as a busy computer does."""

        def receive(self, timeout_s: float) -> Incoming | None:
            incoming = super().receive(timeout_s)
            return None if incoming is None else replace(incoming, time_s=incoming.time_s - 0.3)

    def listen(context: Context) -> Script[None]:
        context.listeners.append(lambda heard: times.append(heard.time_s))
        yield from pause(context, 1.0)

    vehicle = MemoryVehicle()
    for k in range(1, 5):
        vehicle.say(Statustext(text="hello"), after_s=0.2 * k)
    with Late(vehicle) as link:
        start_s = link.now()
        run(Machine(listen), link)
    assert len(times) > 4 and times == sorted(times) and times[0] >= start_s
