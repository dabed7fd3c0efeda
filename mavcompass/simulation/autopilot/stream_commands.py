"""Commands about messages that all firmwares answer alike: intervals, and messages on request."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import AutopilotVersion, CommandInt, CommandLong, MessageInterval
from mavcompass.simulation.autopilot.firmware import Sender
from mavcompass.simulation.autopilot.streams import MESSAGE_IDS, MESSAGES

if TYPE_CHECKING:
    from mavcompass.simulation.vehicle import SimulatedAutopilot

_MESSAGE_INTERVAL_ID = 244


def answer_stream_command(
    vehicle: SimulatedAutopilot, command: CommandLong, sender: Sender
) -> MavResult | None:
    """Carry out a command about messages; None for any other command."""
    first, second = whole(command.param1), whole(command.param2)
    match command.command:
        case MavCmd.SET_MESSAGE_INTERVAL:
            streams = vehicle.streams(sender.port)
            done = streams.set_interval(first, second, vehicle.now_us)
            return MavResult.ACCEPTED if done else MavResult.DENIED
        case MavCmd.GET_MESSAGE_INTERVAL:
            return _tell_interval(vehicle, first, sender)
        case MavCmd.REQUEST_MESSAGE if first == _MESSAGE_INTERVAL_ID:
            return _tell_interval(vehicle, second, sender)
        case MavCmd.REQUEST_MESSAGE:
            return _send_once(vehicle, first, sender)
        case MavCmd.REQUEST_AUTOPILOT_CAPABILITIES:
            return _send_once(vehicle, MESSAGE_IDS[AutopilotVersion], sender)
        case _:
            return None


def whole(value: float) -> int:
    """Read a whole number off a float field; 0 for what is no number."""
    return int(value) if math.isfinite(value) else 0


def as_long(command: CommandInt) -> CommandLong:
    """Read a COMMAND_INT as the COMMAND_LONG of the same meaning (places in degrees)."""
    return CommandLong(
        command.target_system,
        command.target_component,
        command.command,
        0,
        command.param1,
        command.param2,
        command.param3,
        command.param4,
        command.x * 1e-7,
        command.y * 1e-7,
        command.z if math.isfinite(command.z) else 0.0,
    )


def _tell_interval(vehicle: SimulatedAutopilot, number: int, sender: Sender) -> MavResult:
    if not 0 <= number <= 0xFFFF:  # MESSAGE_INTERVAL has no room for it
        return MavResult.FAILED
    interval = vehicle.streams(sender.port).interval_us(number)
    vehicle.send(MessageInterval(number, interval), sender.port)
    return MavResult.ACCEPTED


def _send_once(vehicle: SimulatedAutopilot, number: int, sender: Sender) -> MavResult:
    if number not in vehicle.firmware.available:
        return MavResult.FAILED
    message = vehicle.firmware.report(MESSAGES[number][0], vehicle.now_us, 1.0)
    if message is not None:
        vehicle.send(message, sender.port)
    return MavResult.ACCEPTED
