"""What the vehicle of a recording answers: parameters and commands, as the recording has them."""

from __future__ import annotations

import math
from dataclasses import replace

from mavcompass.enums import MavCmd, MavParamType, MavResult
from mavcompass.messages import (
    CommandAck,
    CommandInt,
    CommandLong,
    Message,
    MessageInterval,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    message_id,
)
from mavcompass.vehicle.links.autopilot import Played, SaidMessage
from mavcompass.vehicle.replay.contents import Contents

_MESSAGE_INTERVAL = 244
# A request for the recorded rate is not refused because the recording lost some messages.
_RATE_SLACK = 1.25
_UNASKED = 65_535


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

    def notice(self, said: Played) -> bool:
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
                answer = (
                    self._interval(second) if number == _MESSAGE_INTERVAL else self._last_said.get(number)
                )
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
