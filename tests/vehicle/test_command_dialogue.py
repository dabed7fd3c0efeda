"""Commands and modes on the wire, as the pages of the protocol's manual have them."""

from __future__ import annotations

import pytest
from dialogue import Expect, Reply, Step, vehicle_script

from mavcompass.enums import MavCmd, MavResult, RoverMode
from mavcompass.errors import NoReply
from mavcompass.messages import CommandAck, CommandLong, Heartbeat
from mavcompass.procedure.commands import command
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.script import Context, Machine, Script, pause
from mavcompass.procedure.vehicle_state import VehicleState, find_vehicle
from mavcompass.vehicle.driver import run

MODE, TAKEOFF = MavCmd.DO_SET_MODE, MavCmd.NAV_TAKEOFF


def beat(mode: int, armed: bool = True) -> Heartbeat:
    return Heartbeat(type=10, autopilot=3, base_mode=129 if armed else 1, custom_mode=mode, system_status=4)


def taking_off(context: Context) -> Script[MavResult]:
    yield from find_vehicle(context)
    return (yield from command(context, TAKEOFF, tries=3, what="the take-off"))


ASKED_TO = [Expect(CommandLong(command=TAKEOFF, confirmation=n)) for n in range(3)]
IN_PROGRESS = CommandAck(TAKEOFF, MavResult.IN_PROGRESS)


@pytest.mark.parametrize(
    ("steps", "result"),
    [
        # It is repeated, its confirmation counted up, until it is answered.
        ((*ASKED_TO, Reply(CommandAck(TAKEOFF, MavResult.DENIED))), MavResult.DENIED),
        # In progress is not an answer but a reason to wait; the answer to another command is none to this.
        ((ASKED_TO[0], Reply(IN_PROGRESS), Reply(IN_PROGRESS, after_s=4.0),
          Reply(CommandAck(TAKEOFF, MavResult.ACCEPTED), after_s=4.0)), MavResult.ACCEPTED),
        ((ASKED_TO[0], Reply(CommandAck(MavCmd.NAV_LAND, MavResult.FAILED)),
          Reply(CommandAck(TAKEOFF, MavResult.ACCEPTED))), MavResult.ACCEPTED),
    ],
)  # fmt: skip
def test_a_command_is_asked_until_its_own_answer_comes(steps: tuple[Step, ...], result: MavResult) -> None:
    with vehicle_script(*steps) as link:
        assert run(Machine(taking_off), link) == result


def test_a_vehicle_that_never_answers_is_said_not_to() -> None:
    with pytest.raises(NoReply, match=r"did not answer the take-off \(3 tries\)"):
        with vehicle_script(*ASKED_TO) as link:
            run(Machine(taking_off), link)


@pytest.mark.parametrize(("foreign", "after_s"), [(False, 0.0), (True, 0.3), (True, 0.8)])
def test_a_mode_is_changed_when_the_heartbeat_says_so_and_put_back_unless_somebody_else_chose_one(
    foreign: bool, after_s: float
) -> None:
    def script(context: Context) -> Script[tuple[bool, bool, int | None]]:
        state = VehicleState()
        context.listeners.append(state.hear)
        yield from find_vehicle(context)
        yield from pause(context, 0.2)
        modes = ModeKeeper(state, "ardupilot")
        changed = yield from modes.change(context, RoverMode.GUIDED)
        yield from pause(context, 0.5)
        is_foreign = modes.is_foreign()
        yield from modes.restore(context)
        return changed, is_foreign, state.mode

    back = (
        Expect(CommandLong(command=MODE, param1=1.0, param2=4.0)),
        Reply(CommandAck(MODE, MavResult.ACCEPTED)),
        Reply(beat(RoverMode.HOLD), after_s=0.1),
    )
    with vehicle_script(
        Reply(beat(RoverMode.HOLD)),
        Expect(CommandLong(command=MODE, param1=1.0, param2=15.0)),
        Reply(CommandAck(MODE, MavResult.ACCEPTED)),
        Reply(beat(RoverMode.GUIDED), after_s=0.1),
        # What was chosen at last may be heard of only when the old one is to be put back.
        *([Reply(beat(RoverMode.MANUAL), after_s=after_s)] if foreign else back),
    ) as link:
        # The only heart that beats here is the script's.
        link.autopilot.beats = False  # type: ignore[attr-defined]
        mode = RoverMode.MANUAL if foreign else RoverMode.HOLD
        assert run(Machine(script), link) == (True, foreign and after_s < 0.5, mode)


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
