"""MAV_CMD_SET_EKF_SOURCE_SET as the manual has it: a set without a compass, and back to the first."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from dialogue import Expect, Reply, vehicle_script

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import Refused
from mavcompass.messages import CommandAck, CommandLong
from mavcompass.procedure.script import Context, Machine, Script, Stop
from mavcompass.procedure.vehicle_state import find_vehicle
from mavcompass.vehicle.dialects.taking_over import EKF3_HOW, idle_set, prompt_ekf3, take_ekf3_yaw
from mavcompass.vehicle.driver import run

SWITCH = MavCmd.SET_EKF_SOURCE_SET
AS_SHIPPED = {"AHRS_EKF_TYPE": 3.0, "EK3_SRC1_YAW": 1.0}
AS_SHIPPED |= {f"EK3_SRC{n}_{what}": 0.0 for n in (2, 3) for what in ("POSXY", "YAW")}
THERE_AND_BACK = (
    Expect(CommandLong(command=SWITCH, param1=2.0)),
    Reply(CommandAck(SWITCH, MavResult.ACCEPTED)),
    Expect(CommandLong(command=SWITCH, param1=1.0)),
    Reply(CommandAck(SWITCH, MavResult.ACCEPTED)),
)


def take(parameters: Mapping[str, float], flying: bool = False) -> Machine[str]:
    def script(context: Context) -> Script[str]:
        yield from find_vehicle(context)
        return (yield from take_ekf3_yaw(context, parameters, flying))

    return Machine(script)


HEADING, LEFT = {"EK3_YAW_M_NSE": 0.05, "EK3_GBIAS_P_NSE": 0.1}, dict[str, float]()
FIELD = {"EK3_MAG_EF_LIM": 1.0, "EK3_MAG_M_NSE": 0.001, "EK3_GBIAS_P_NSE": 0.03, "EK3_MAG_I_GATE": 1000.0}


@pytest.mark.parametrize(
    ("held", "on_the_ground", "in_flight", "idle"),
    [({}, HEADING, FIELD, 2), ({"EK3_MAG_CAL": 2.0}, HEADING, HEADING, 2),
     ({"EK3_SRC1_YAW": 3.0}, HEADING, FIELD, 2), ({"EK3_SRC1_YAW": 2.0}, LEFT, LEFT, None),
     ({"AHRS_EKF_TYPE": 2.0}, LEFT, LEFT, None), ({"EK3_SRC2_YAW": 1.0}, HEADING, FIELD, 3),
     ({"EK3_SRC2_YAW": 1.0, "EK3_SRC3_YAW": 1.0}, HEADING, FIELD, None),
     ({"EK3_SRC3_POSXY": 3.0}, HEADING, FIELD, None)],
)  # fmt: skip
def test_an_estimator_is_told_to_believe_the_compass_that_it_follows_and_has_a_set_to_rest_on(
    held: dict[str, float], on_the_ground: dict[str, float], in_flight: dict[str, float], idle: int | None
) -> None:
    parameters = AS_SHIPPED | held
    told = [prompt_ekf3(parameters, flying) for flying in (False, True)]
    assert (*told, idle_set(parameters)) == (on_the_ground, in_flight, idle)


def test_the_second_set_for_a_moment_then_the_first_again() -> None:
    with vehicle_script(*THERE_AND_BACK) as link:
        assert run(take(AS_SHIPPED), link) == EKF3_HOW


def test_firmware_that_does_not_know_the_command_is_left_as_it_is() -> None:
    with vehicle_script(
        Expect(CommandLong(command=SWITCH, param1=2.0)), Reply(CommandAck(SWITCH, MavResult.UNSUPPORTED))
    ) as link:
        assert run(take(AS_SHIPPED), link) == ""


def test_the_way_back_is_asked_for_until_it_is_answered() -> None:
    with vehicle_script(
        Expect(CommandLong(command=SWITCH, param1=2.0)),
        Reply(CommandAck(SWITCH, MavResult.ACCEPTED)),
        Expect(CommandLong(command=SWITCH, param1=1.0)),
        Expect(CommandLong(command=SWITCH, param1=1.0, confirmation=1)),
        Reply(CommandAck(SWITCH, MavResult.ACCEPTED)),
    ) as link:
        assert run(take(AS_SHIPPED), link) == EKF3_HOW


def test_a_stop_in_between_still_leads_back() -> None:
    with vehicle_script(*THERE_AND_BACK) as link:
        machine = take(AS_SHIPPED)
        inner = machine.step

        def step(event):  # type: ignore[no-untyped-def]
            actions = inner(event)
            if isinstance(getattr(event, "message", None), CommandAck):
                machine.step = inner  # type: ignore[method-assign]
                actions += inner(Stop(event.time_s, "Enough."))
            return actions

        machine.step = step  # type: ignore[method-assign]
        with pytest.raises(Refused, match="Enough"):
            run(machine, link)


def test_a_flying_copter_is_not_touched() -> None:
    with vehicle_script() as link:
        assert run(take(AS_SHIPPED, flying=True), link) == ""


def test_nothing_is_commanded_before_the_yaw_is_in_force() -> None:
    # A heading named relative to the yaw before would turn the vehicle the other way round.
    with vehicle_script(*THERE_AND_BACK) as link:
        machine, heard_s = take(AS_SHIPPED), []
        inner = machine.step

        def step(event):  # type: ignore[no-untyped-def]
            if isinstance(getattr(event, "message", None), CommandAck):
                heard_s.append(event.time_s)
            return inner(event)

        machine.step = step  # type: ignore[method-assign]
        run(machine, link)
        # What the estimator's compass takes for a reading, and no longer.
        assert 0.1 <= machine.context.now - heard_s[-1] < 0.2 and 0.05 < heard_s[-1] - heard_s[0] < 0.2
