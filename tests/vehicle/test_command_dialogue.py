"""Commands, message rates and modes on the wire, as the pages of the protocol's manual have them."""

from __future__ import annotations

import pytest
from dialogue import Expect, Reply, Step, vehicle_script

from mavcompass.enums import MavCmd, MavResult, RoverMode
from mavcompass.errors import NoReply
from mavcompass.messages import CommandAck, CommandLong, Heartbeat, MessageInterval, RawImu
from mavcompass.procedure.commands import MessageRates, command
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.script import Context, Machine, Script, pause
from mavcompass.procedure.vehicle_state import VehicleState, find_vehicle
from mavcompass.vehicle.driver import run

GET, SET, MODE = MavCmd.GET_MESSAGE_INTERVAL, MavCmd.SET_MESSAGE_INTERVAL, MavCmd.DO_SET_MODE
TAKEOFF = MavCmd.NAV_TAKEOFF


def beat(mode: int, armed: bool = True) -> Heartbeat:
    return Heartbeat(type=10, autopilot=3, base_mode=129 if armed else 1, custom_mode=mode, system_status=4)


def test_a_command_is_repeated_with_its_confirmation_counted_up_until_it_is_answered() -> None:
    def script(context: Context) -> Script[MavResult]:
        yield from find_vehicle(context)
        return (yield from command(context, TAKEOFF, param))

    param = 0.0
    with vehicle_script(
        Expect(CommandLong(command=TAKEOFF, confirmation=0)),
        Expect(CommandLong(command=TAKEOFF, confirmation=1)),
        Expect(CommandLong(command=TAKEOFF, confirmation=2)),
        Reply(CommandAck(TAKEOFF, MavResult.DENIED)),
    ) as link:
        assert run(Machine(script), link) == MavResult.DENIED


def test_in_progress_is_not_an_answer_but_a_reason_to_wait() -> None:
    def script(context: Context) -> Script[MavResult]:
        yield from find_vehicle(context)
        return (yield from command(context, TAKEOFF))

    with vehicle_script(
        Expect(CommandLong(command=TAKEOFF)),
        Reply(CommandAck(TAKEOFF, MavResult.IN_PROGRESS)),
        Reply(CommandAck(TAKEOFF, MavResult.IN_PROGRESS), after_s=4.0),
        Reply(CommandAck(TAKEOFF, MavResult.ACCEPTED), after_s=4.0),
    ) as link:
        assert run(Machine(script), link) == MavResult.ACCEPTED


def test_the_answer_to_another_command_is_none_to_this() -> None:
    def script(context: Context) -> Script[MavResult]:
        yield from find_vehicle(context)
        return (yield from command(context, TAKEOFF))

    with vehicle_script(
        Expect(CommandLong(command=TAKEOFF)),
        Reply(CommandAck(MavCmd.NAV_LAND, MavResult.FAILED)),
        Reply(CommandAck(TAKEOFF, MavResult.ACCEPTED)),
    ) as link:
        assert run(Machine(script), link) == MavResult.ACCEPTED


def test_a_vehicle_that_never_answers_is_said_not_to() -> None:
    def script(context: Context) -> Script[MavResult]:
        yield from find_vehicle(context)
        return (yield from command(context, TAKEOFF, tries=2, what="the take-off"))

    with (
        pytest.raises(NoReply, match=r"did not answer the take-off \(2 tries\)"),
        vehicle_script(
            Expect(CommandLong(command=TAKEOFF, confirmation=0)),
            Expect(CommandLong(command=TAKEOFF, confirmation=1)),
        ) as link,
    ):
        run(Machine(script), link)


def test_a_rate_is_asked_for_lower_where_it_is_denied_and_put_back_afterwards() -> None:
    def script(context: Context) -> Script[dict[type, bool]]:
        yield from find_vehicle(context)
        rates = MessageRates()
        granted = yield from rates.ask(context, {RawImu: 50.0})
        yield from rates.restore(context)
        return dict(granted)

    with vehicle_script(
        Expect(CommandLong(command=GET, param1=27.0)),
        Reply(MessageInterval(27, 500_000)),
        Expect(CommandLong(command=SET, param1=27.0, param2=20_000.0)),
        Reply(CommandAck(SET, MavResult.DENIED)),
        Expect(CommandLong(command=SET, param1=27.0, param2=40_000.0)),
        Reply(CommandAck(SET, MavResult.ACCEPTED)),
        Expect(CommandLong(command=SET, param1=27.0, param2=500_000.0)),
        Reply(CommandAck(SET, MavResult.ACCEPTED)),
        Expect(CommandLong(command=GET, param1=27.0)),
        Reply(MessageInterval(27, 500_000)),
    ) as link:
        assert run(Machine(script), link) == {RawImu: True}


def test_a_rate_that_is_fast_enough_is_left_alone() -> None:
    def script(context: Context) -> Script[None]:
        yield from find_vehicle(context)
        rates = MessageRates()
        yield from rates.ask(context, {RawImu: 10.0})
        yield from rates.restore(context)

    with vehicle_script(
        Expect(CommandLong(command=GET, param1=27.0)),
        Reply(MessageInterval(27, 50_000)),
    ) as link:
        run(Machine(script), link)


def test_a_mode_is_changed_when_the_heartbeat_says_so_and_put_back() -> None:
    def script(context: Context) -> Script[tuple[bool, int | None]]:
        state = VehicleState()
        context.listeners.append(state.hear)
        yield from find_vehicle(context)
        yield from pause(context, 0.2)
        modes = ModeKeeper(state, "ardupilot")
        changed = yield from modes.change(context, RoverMode.GUIDED)
        yield from modes.restore(context)
        return changed, state.mode

    with vehicle_script(
        Reply(beat(RoverMode.HOLD)),
        Expect(CommandLong(command=MODE, param1=1.0, param2=15.0)),
        Reply(CommandAck(MODE, MavResult.ACCEPTED)),
        Reply(beat(RoverMode.GUIDED), after_s=0.1),
        Expect(CommandLong(command=MODE, param1=1.0, param2=4.0)),
        Reply(CommandAck(MODE, MavResult.ACCEPTED)),
        Reply(beat(RoverMode.HOLD), after_s=0.1),
    ) as link:
        # The only heart that beats here is the script's.
        link.autopilot.beats = False  # type: ignore[attr-defined]
        assert run(Machine(script), link) == (True, RoverMode.HOLD)


def test_a_mode_that_somebody_else_chose_is_not_taken_from_them() -> None:
    def script(context: Context) -> Script[int | None]:
        state = VehicleState()
        context.listeners.append(state.hear)
        yield from find_vehicle(context)
        yield from pause(context, 0.2)
        modes = ModeKeeper(state, "ardupilot")
        yield from modes.change(context, RoverMode.GUIDED)
        yield from pause(context, 0.5)
        assert modes.is_foreign()
        yield from modes.restore(context)
        return state.mode

    with vehicle_script(
        Reply(beat(RoverMode.HOLD)),
        Expect(CommandLong(command=MODE, param1=1.0, param2=15.0)),
        Reply(CommandAck(MODE, MavResult.ACCEPTED)),
        Reply(beat(RoverMode.GUIDED), after_s=0.1),
        Reply(beat(RoverMode.MANUAL), after_s=0.3),
    ) as link:
        link.autopilot.beats = False  # type: ignore[attr-defined]
        assert run(Machine(script), link) == RoverMode.MANUAL


ASKED = Expect(CommandLong(command=MODE, param1=1.0, param2=15.0))
DENIED, ACCEPTED = (Reply(CommandAck(MODE, result)) for result in (MavResult.DENIED, MavResult.ACCEPTED))


@pytest.mark.parametrize(
    ("steps", "changed", "within_s"),
    [
        ((ASKED, DENIED, ASKED, DENIED), False, 1.5),  # two refusals are an answer
        ((ASKED, DENIED, ASKED, ACCEPTED, Reply(beat(RoverMode.GUIDED))), True, 1.5),
        ((ASKED, ASKED, ACCEPTED, Reply(beat(RoverMode.GUIDED), after_s=1.2)), True, 2.5),
        ((ASKED, ASKED), False, 2.0),  # nothing is heard of it any more
        ((*[ASKED, ACCEPTED, Reply(beat(RoverMode.HOLD), after_s=1.0)] * 3, ASKED, ACCEPTED), False, 5.5),
    ],
)
def test_a_mode_is_asked_for_until_it_is_refused_twice_heard_of_or_hopeless(
    steps: tuple[Step, ...], changed: bool, within_s: float
) -> None:
    def script(context: Context) -> Script[bool]:
        state = VehicleState()
        context.listeners.append(state.hear)
        yield from find_vehicle(context)
        yield from pause(context, 0.2)
        modes, began_s = ModeKeeper(state, "ardupilot"), context.now
        done = yield from modes.change(context, RoverMode.GUIDED)
        assert within_s - 1.5 < context.now - began_s < within_s
        assert not modes.is_foreign()  # meanwhile the old one and the new are ours
        return done

    with vehicle_script(Reply(beat(RoverMode.HOLD)), *steps) as link:
        link.autopilot.beats = False  # type: ignore[attr-defined]
        assert run(Machine(script), link) is changed
