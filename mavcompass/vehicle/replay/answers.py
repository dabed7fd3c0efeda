"""What a recording says of its vehicle, and what that answers: parameters and commands, as it has them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

from mavcompass.enums import MavAutopilot, MavCmd, MavParamType, MavResult, MavType
from mavcompass.errors import BadRecording
from mavcompass.messages import (
    Attitude,
    CommandAck,
    CommandInt,
    CommandLong,
    Heartbeat,
    Message,
    MessageInterval,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    RawImu,
    ScaledImu,
    ScaledImu2,
    ScaledImu3,
    SystemTime,
    message_id,
)
from mavcompass.two_clocks import shared_id
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.autopilot import SaidMessage
from mavcompass.vehicle.replay.tlog import RecordingClock, tlog_frames
from mavcompass.vehicle.wire import decode

# A request for the recorded rate is not refused because the recording lost some messages.
_RATE_SLACK = 1.25
_UNASKED = 65_535


@dataclass(slots=True)
class Contents:
    """Hold what a recording says of its vehicle.

    Attributes:
        system, component: the autopilot's address. stations: addresses of ground stations.
        parameters: the first value of each, as PARAM_VALUE. results: the first COMMAND_ACK of each command.
        counts: messages of the autopilot by id, for their rates; duration_s: of the whole.
        readings_from_s: when a compass was first heard, 0 for never.
    """

    system: int = 1
    component: int = 1
    stations: set[tuple[int, int]] = field(default_factory=set)
    parameters: dict[str, ParamValue] = field(default_factory=dict)
    results: dict[int, int] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    duration_s: float = 0.0
    readings_from_s: float = 0.0

    def interval_us(self, message_id: int) -> int:
        """Return the mean time between messages of an id, microseconds; 0 if there are none."""
        count = self.counts.get(message_id, 0)
        return round(self.duration_s * 1e6 / count) if count else 0


def survey(path: Path) -> Contents:
    """Read a .tlog once, for what the vehicle must be able to answer from the start.

    Raises BadRecording where no autopilot is in it, or two share a system id.
    """
    frames: dict[tuple[int, int], int] = {}
    vehicles: dict[tuple[int, int], Contents] = {}
    stations: set[tuple[int, int]] = set()
    autopilots: set[tuple[int, int]] = set()
    heard = LinkStatistics()
    telling = {message_id(kind) for kind in (Heartbeat, ParamValue, CommandAck, Attitude, SystemTime)}
    readings = {message_id(kind) for kind in (RawImu, ScaledImu, ScaledImu2, ScaledImu3)}
    clock = RecordingClock()
    for stamp_s, frame in tlog_frames(path):
        sender = (frame.system, frame.component)
        clock.advance(stamp_s)
        frames[sender] = frames.get(sender, 0) + 1
        if (contents := vehicles.get(sender)) is None:
            contents = vehicles[sender] = Contents(*sender)
        contents.counts[frame.message_id] = contents.counts.get(frame.message_id, 0) + 1
        if frame.message_id in readings:
            contents.readings_from_s = contents.readings_from_s or clock.time_s
        if frame.message_id not in telling:
            continue
        match message := decode(frame.message_id, frame.payload):
            case Attitude() | SystemTime():
                heard.count(*sender, frame.sequence, message)
            case Heartbeat(type=MavType.GCS):
                stations.add(sender)
            case Heartbeat(autopilot=autopilot) if autopilot != MavAutopilot.INVALID:
                autopilots.add(sender)
            case ParamValue() as value:
                contents.parameters.setdefault(value.param_id, value)
            case CommandAck(command, result):
                contents.results.setdefault(command, result)
    autopilots -= stations
    if not autopilots:
        raise BadRecording(f"{path} has no heartbeat of an autopilot.", "Give a recording of a vehicle.")
    chosen = vehicles[max(autopilots, key=frames.__getitem__)]
    if chosen.system in heard.shared:
        raise BadRecording(*shared_id(chosen.system))
    for other in vehicles.values():
        # No component is without a heartbeat: MAVProxy logs so what it fetched from the vehicle as a file.
        if other.system == chosen.system and message_id(Heartbeat) not in other.counts:
            chosen.parameters |= other.parameters
    chosen.duration_s, chosen.stations = clock.time_s, stations
    return chosen


class Answers:
    """Hear requests and answer them; notice what is played, to know it when asked."""

    def __init__(self, contents: Contents) -> None:
        self._contents = contents
        self._values = dict(contents.parameters)
        self._order = list(contents.parameters)
        self._written: set[str] = set()
        self._last_said: dict[int, Message] = {}
        self._outbox: list[SaidMessage] = []

    def take(self) -> list[SaidMessage]:
        """Return the answers since the last call."""
        answers, self._outbox = self._outbox, []
        return answers

    def notice(self, said: SaidMessage) -> bool:
        """Take in what is played; False for a parameter value that has been overwritten since."""
        contents = self._contents
        message = said.message
        if message is None or (said.system, said.component) != (contents.system, contents.component):
            return True
        self._last_said[message_id(type(message))] = message
        if isinstance(message, ParamValue):
            if message.param_id in self._written:
                return False
            self._values[message.param_id] = message
        return True

    def hear(self, message: Message, port: int, now_s: float) -> None:
        """Answer a message that is for this vehicle; others are ignored."""
        if getattr(message, "target_system", 0) not in (0, self._contents.system):
            return
        match message:
            case ParamRequestList():
                self._say_parameters(self._order, port, now_s)
            case ParamRequestRead(param_id=name, param_index=index):
                if 0 <= index < len(self._order):
                    name = self._order[index]
                if name in self._values:
                    self._say_parameters([name], port, now_s)
            case ParamSet(param_id=name, param_value=value):
                self._write(name, value, now_s)
            case CommandLong(command=command) | CommandInt(command=command):
                self._obey(message, command, port, now_s)

    def _write(self, name: str, value: float, now_s: float) -> None:
        if name not in self._values:
            return
        # PX4's whole numbers are bits in the place of a float, and some of those spell NaN.
        if math.isfinite(value) or self._values[name].param_type != MavParamType.REAL32:
            self._values[name] = replace(self._values[name], param_value=value)
            self._written.add(name)
            self._say(replace(self._values[name], param_index=_UNASKED), None, now_s)

    def _say_parameters(self, names: list[str], port: int, now_s: float) -> None:
        for name in names:
            index, count = self._order.index(name), len(self._order)
            self._say(replace(self._values[name], param_index=index, param_count=count), port, now_s)

    def _obey(self, message: CommandLong | CommandInt, command: int, port: int, now_s: float) -> None:
        result = self._contents.results.get(command, int(MavResult.UNSUPPORTED))
        number, second = _whole(message.param1), _whole(message.param2)
        answer: Message | None = None
        match command:
            case MavCmd.SET_MESSAGE_INTERVAL:
                # Rates are what they were: a lower one is no reason to refuse, a higher one is.
                interval_us = self._contents.interval_us(number)
                slow_enough = second <= 0 or second * _RATE_SLACK >= interval_us
                result = MavResult.ACCEPTED if interval_us and slow_enough else MavResult.DENIED
            case MavCmd.GET_MESSAGE_INTERVAL:
                answer = self._interval(number)
            case MavCmd.REQUEST_MESSAGE:
                of_a_rate = number == message_id(MessageInterval)
                answer = self._interval(second) if of_a_rate else self._last_said.get(number)
        if answer is not None:
            result = MavResult.ACCEPTED
        self._say(CommandAck(command, int(result)), port, now_s)
        if answer is not None:
            self._say(answer, port, now_s)

    def _interval(self, number: int) -> MessageInterval | None:
        """Tell a rate; MESSAGE_INTERVAL has no room for larger numbers."""
        return MessageInterval(number, self._contents.interval_us(number)) if 0 <= number <= 0xFFFF else None

    def _say(self, message: Message, port: int | None, now_s: float) -> None:
        contents = self._contents
        self._outbox.append(SaidMessage(now_s, contents.system, contents.component, message, port))


def _whole(value: float) -> int:
    """Read a whole number off a float field; -1 for what is no number."""
    return int(value) if math.isfinite(value) else -1
