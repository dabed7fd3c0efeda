"""What must hold on any vehicle: the simulated ones here, or whatever is at `--mav-url URL`.

Nothing is moved, and what is changed is put back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
import pytest
from serving import serving

from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import (
    Attitude,
    CommandAck,
    CommandLong,
    Incoming,
    Message,
    MessageInterval,
    ParamRequestRead,
    ParamValue,
    RawImu,
    ScaledImu,
    message_id,
)
from mavcompass.procedure.script import Context, Machine, Script, pause, request
from mavcompass.procedure.vehicle_state import VehicleIdentity, find_vehicle
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.opening import open_link

T = TypeVar("T")
KINDS = ("rover", "copter", "px4-copter")


@pytest.fixture(scope="module", params=KINDS)
def link(request: pytest.FixtureRequest) -> Iterator[Link]:
    """A link to the vehicle at --mav-url, or over TCP to a simulated one."""
    url = request.config.getoption("--mav-url")
    if url is not None:
        if request.param != KINDS[0]:
            pytest.skip("--mav-url names one vehicle")
        with open_link(str(url)) as there:
            yield there
        return
    with serving(SimulatedAutopilot(request.param, seed=4), speed=4.0) as (_, port):
        with open_link(f"tcp:127.0.0.1:{port}") as there:
            yield there


def on(link: Link, work: Callable[[Context, VehicleIdentity], Script[T]]) -> T:
    def script(context: Context) -> Script[T]:
        vehicle = yield from find_vehicle(context)
        return (yield from work(context, vehicle))

    return run(Machine(script), link)


def command(context: Context, number: int, *parameters: float) -> Script[int]:
    ask = CommandLong(context.system, context.component, number, 0, *parameters)
    ack = yield from request(context, ask, CommandAck, lambda a: a.command == number)
    return ack.result


def field_message(vehicle: VehicleIdentity) -> type[Message]:
    return ScaledImu if vehicle.autopilot == "px4" else RawImu


def test_it_is_found_among_all_that_speak_on_the_link(link: Link) -> None:
    def work(context: Context, vehicle: VehicleIdentity) -> Script[VehicleIdentity]:
        yield from pause(context, 0.0)
        return vehicle

    vehicle = on(link, work)
    assert vehicle.autopilot in ("ardupilot", "px4") and vehicle.component == 1
    assert link.identity.system == vehicle.system


def test_a_message_comes_at_the_rate_that_was_asked_for(link: Link) -> None:
    def work(context: Context, vehicle: VehicleIdentity) -> Script[tuple[int, list[float]]]:
        kind = field_message(vehicle)
        number = float(message_id(kind))
        ask = CommandLong(context.system, context.component, MavCmd.GET_MESSAGE_INTERVAL, 0, number)
        was = yield from request(context, ask, MessageInterval, lambda m: m.message_id == number)
        result = yield from command(context, MavCmd.SET_MESSAGE_INTERVAL, number, 1e6 / 20.0)
        yield from pause(context, 0.3)
        stamps_s: list[float] = []
        give_up_s = context.now + 20.0  # a busy machine plays the simulated vehicle slowly
        while len(stamps_s) < 20 and context.now < give_up_s:
            event = yield give_up_s
            if isinstance(event, Incoming) and type(event.message) is kind:
                stamps_s.append(_stamp_s(event.message))
        yield from command(context, MavCmd.SET_MESSAGE_INTERVAL, number, float(was.interval_us or -1))
        return result, stamps_s

    result, stamps_s = on(link, work)
    assert result == MavResult.ACCEPTED
    assert len(stamps_s) == 20 and np.mean(np.diff(stamps_s)) == pytest.approx(0.05, rel=0.1)


def _stamp_s(message: Message) -> float:
    return message.time_usec * 1e-6 if isinstance(message, RawImu) else message.time_boot_ms * 1e-3  # type: ignore[attr-defined]


def test_field_and_attitude_are_plausible(link: Link) -> None:
    fields: list[float] = []
    yaws: list[float] = []

    def listen(incoming: Incoming) -> None:
        match incoming.message:
            case RawImu() | ScaledImu() as imu:
                fields.append(math.hypot(imu.xmag, imu.ymag, imu.zmag))
            case Attitude(yaw=yaw):
                yaws.append(yaw)

    def script(context: Context) -> Script[None]:
        vehicle = yield from find_vehicle(context)
        for kind in (field_message(vehicle), Attitude):
            yield from command(context, MavCmd.SET_MESSAGE_INTERVAL, float(message_id(kind)), 1e5)
        yield from pause(context, 1.0)
        for kind in (field_message(vehicle), Attitude):
            yield from command(context, MavCmd.SET_MESSAGE_INTERVAL, float(message_id(kind)), 0.0)

    run(Machine(script), link, on_message=listen)
    assert len(fields) > 5 and 100.0 < np.median(fields) < 1500.0, "milligauss"
    assert len(yaws) > 5 and all(-math.pi <= yaw <= math.pi for yaw in yaws)


def test_an_unknown_command_is_refused_and_an_unknown_parameter_stays_unanswered(link: Link) -> None:
    def work(context: Context, vehicle: VehicleIdentity) -> Script[tuple[int, bool]]:
        result = yield from command(context, 31_999)
        context.send(ParamRequestRead(context.system, context.component, "NO_SUCH_NAME"))
        answered = False
        end_s = context.now + 0.7
        while context.now < end_s:
            event = yield end_s
            if isinstance(event, Incoming) and isinstance(event.message, ParamValue):
                answered = answered or event.message.param_id == "NO_SUCH_NAME"
        return result, answered

    result, answered = on(link, work)
    assert result not in (MavResult.ACCEPTED, MavResult.IN_PROGRESS)
    assert not answered


def test_nothing_was_lost_or_damaged_on_the_way(link: Link) -> None:
    assert link.statistics.malformed == 0
    assert link.statistics.lost <= 0.01 * link.statistics.received
