"""MAVLink's parameter protocol: ask for many at once, ask again, and never trust an echo.

The protocol has no request numbers: a PARAM_VALUE may answer a read, echo a write, or be neither.
ArduPilot answers the write of an `_X` element with the current values of X, Y *and* Z, and says
nothing about a name it does not know. So a write is believed when a value equal to the wanted one is
heard, a read-back is made after the echoes have died away, and a name counts as absent when it stayed
silent for as many tries as a name that exists would not, judged by how often the others answered.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavcompass.enums import MavParamType
from mavcompass.errors import NoReply
from mavcompass.messages import Message, ParamRequestRead, ParamSet, ParamValue
from mavcompass.procedure.script import Context, Script, pause

# ArduPilot sends an integer as the float of the same value; PX4 puts its four bytes into the float's place.
Encoding = Literal["cast", "bytewise"]

WINDOW = 8  # requests under way at once; ArduPilot's own queue holds 20
SILENCE_S = 8.0  # a vehicle that says nothing at all for so long is not there
_FIRST_PATIENCE_S = 0.8
_PATIENCE_LIMITS_S = (0.25, 3.0)
_FALSE_ABSENCE = 1e-5  # probability of calling a parameter absent that exists
_FEWEST_TRIES, _MOST_TRIES = 4, 25
_INTEGER_FORMATS: dict[int, str] = {
    MavParamType.UINT8: "<Bxxx",
    MavParamType.INT8: "<bxxx",
    MavParamType.UINT16: "<Hxx",
    MavParamType.INT16: "<hxx",
    MavParamType.UINT32: "<I",
    MavParamType.INT32: "<i",
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """Hold a parameter's value and its MAV_PARAM_TYPE, which a write must name."""

    value: float
    type: int = MavParamType.REAL32


class ValueRefused(NoReply):
    """Report a vehicle that answers a write by keeping another value."""


def is_single(value: float) -> bool:
    """Tell whether a value is finite and fits the wire's 32-bit float."""
    return math.isfinite(value) and abs(value) <= float(np.finfo(np.float32).max)


def tidy(value: float) -> float:
    """Return the shortest decimal number with the same 32-bit float: 0.1 for 0.10000000149011612.

    A value that is not finite stays as it is.
    """
    return float(str(np.float32(value))) if is_single(value) else value


def same_value(left: float, right: float) -> bool:
    """Compare two values as the vehicle stores them, as 32-bit floats."""
    return is_single(left) and is_single(right) and bool(np.float32(left) == np.float32(right))


def decode(message: ParamValue, encoding: Encoding) -> Parameter:
    """Read a PARAM_VALUE; a 32-bit float becomes its shortest decimal."""
    form = _INTEGER_FORMATS.get(message.param_type) if encoding == "bytewise" else None
    if form is None:
        return Parameter(tidy(message.param_value), message.param_type)
    (whole,) = struct.unpack(form, struct.pack("<f", message.param_value))
    return Parameter(float(whole), message.param_type)


def encode(name: str, parameter: Parameter, encoding: Encoding, context: Context) -> ParamSet:
    """Build the PARAM_SET that writes a value."""
    value = parameter.value
    form = _INTEGER_FORMATS.get(parameter.type) if encoding == "bytewise" else None
    if form is not None:
        (value,) = struct.unpack("<f", struct.pack(form, round(value)))
    return ParamSet(context.system, context.component, name, value, parameter.type)


def read(
    context: Context,
    names: Sequence[str],
    encoding: Encoding,
    enough: Callable[[Mapping[str, Parameter]], bool] = lambda _: False,
) -> Script[dict[str, Parameter]]:
    """Read parameters by name, several at a time; a name that the vehicle does not know is left out.

    `enough` may end the reading early, given what was heard so far. Raises NoReply where the vehicle
    says nothing at all for `SILENCE_S`.
    """
    asks = [_Ask(name, (_read_request(context, name),)) for name in dict.fromkeys(names)]
    exchange = _Exchange(context, encoding, asks)
    yield from exchange.run(SILENCE_S, enough)
    return {name: exchange.answers[name] for name in names if name in exchange.answers}


def write(
    context: Context, wanted: Mapping[str, Parameter], encoding: Encoding, silence_s: float = SILENCE_S
) -> Script[None]:
    """Write parameters until each is heard with its wanted value.

    Raises ValueRefused where the vehicle keeps another value, NoReply where it does not answer.
    """
    asks = [
        _Ask(name, (encode(name, p, encoding, context),), p.value, again=(_read_request(context, name),))
        for name, p in wanted.items()
    ]
    yield from _complete(context, asks, encoding, silence_s, "took")


def read_back(
    context: Context, wanted: Mapping[str, Parameter], encoding: Encoding, silence_s: float = SILENCE_S
) -> Script[None]:
    """Prove by reading that the vehicle holds these values, once the echoes of writing have died away.

    Raises ValueRefused where it holds another value, NoReply where it does not answer.
    """
    yield from pause(context, _PATIENCE_LIMITS_S[0])
    asks = [_Ask(name, (_read_request(context, name),), p.value) for name, p in wanted.items()]
    yield from _complete(context, asks, encoding, silence_s, "gave")


def _read_request(context: Context, name: str) -> ParamRequestRead:
    return ParamRequestRead(context.system, context.component, name)


def _complete(
    context: Context, asks: Sequence[_Ask], encoding: Encoding, silence_s: float, verb: str
) -> Script[None]:
    exchange = _Exchange(context, encoding, asks)
    yield from exchange.run(silence_s)
    for ask in asks:
        if ask.name in exchange.answers:
            continue
        if ask.other_value is not None:
            raise ValueRefused(
                f"The vehicle keeps {ask.name} at {ask.other_value:g} instead of {ask.wanted:g}.",
                "Check that nobody else is changing parameters, and that the value is within its range.",
            )
        raise NoReply(
            f"The vehicle never {verb} {ask.name} ({ask.tries} tries).",
            "Check the link; if it is slow or lossy, bring the radios closer and run again.",
        )


@dataclass(slots=True)
class _Ask:
    """Be one name's dialogue: what is sent, which value ends it (None: any), how it stands."""

    name: str
    first: tuple[Message, ...]
    wanted: float | None = None
    again: tuple[Message, ...] = ()  # sent beside `first` from the second try on
    tries: int = 0
    sent_s: float = 0.0
    due_s: float = -math.inf
    others: int = 0  # values heard that were not the wanted one
    other_value: float | None = None

    def refused(self) -> bool:
        """Tell whether other values came too often to be late echoes."""
        return self.others >= 4 and self.tries >= 3


class _Exchange:
    """Carry on many dialogues at once, with a patience learnt from the answers."""

    def __init__(self, context: Context, encoding: Encoding, asks: Iterable[_Ask]) -> None:
        self.context = context
        self.encoding = encoding
        self.open = {ask.name: ask for ask in asks}
        self.answers: dict[str, Parameter] = {}
        self.sent = 0  # how often the names that answered had been asked
        self.round_trip_s: float | None = None
        self.deviation_s = 0.0

    def run(
        self, silence_s: float, enough: Callable[[Mapping[str, Parameter]], bool] = lambda _: False
    ) -> Script[None]:
        """Ask until every name has answered or is given up."""
        context, last_heard_s, wake_s = self.context, self.context.now, -math.inf
        while self.open:
            if context.now >= wake_s:
                wake_s = self._ask()
                if not self.open:
                    return
            event = yield min(wake_s, last_heard_s + silence_s)
            if (heard := context.heard_from_vehicle(event)) is not None:
                last_heard_s = context.now
                if self._take(heard.message):
                    wake_s = -math.inf  # room for the next name
                    if enough(self.answers):
                        return
            elif context.now >= last_heard_s + silence_s:
                raise NoReply(
                    f"The vehicle has been silent for {silence_s:g} s.",
                    "Check the vehicle's power and the link, then run again.",
                )

    def _ask(self) -> float:
        """Send what is due within the window; return when to look again."""
        now = self.context.now
        for ask in [a for a in self.open.values() if a.tries and a.due_s <= now]:
            if ask.refused() or ask.tries >= self._most_tries():
                del self.open[ask.name]
        under_way = sum(1 for ask in self.open.values() if ask.due_s > now)
        for ask in [a for a in self.open.values() if a.due_s <= now][: max(0, WINDOW - under_way)]:
            for message in ask.first + (ask.again if ask.tries else ()):
                self.context.send(message)
            ask.tries += 1
            ask.sent_s, ask.due_s = now, now + self._patience_s(ask.tries)
        return min((ask.due_s for ask in self.open.values() if ask.due_s > now), default=now)

    def _take(self, message: Message) -> bool:
        """Use a PARAM_VALUE that was waited for; tell whether it ended a dialogue."""
        if not isinstance(message, ParamValue):
            return False
        ask = self.open.get(message.param_id)
        if ask is None or not ask.tries:
            return False
        parameter = decode(message, self.encoding)
        if ask.wanted is not None and not same_value(parameter.value, ask.wanted):
            ask.others, ask.other_value = ask.others + 1, parameter.value
            return False
        del self.open[ask.name]
        self.answers[ask.name] = parameter
        self.sent += ask.tries
        if ask.tries == 1:  # of a name asked twice nobody knows which request was answered (Karn)
            self._learn(self.context.now - ask.sent_s)
        return True

    def _learn(self, round_trip_s: float) -> None:
        """Smooth the round trip and its deviation as TCP does (RFC 6298, equations 2.2 and 2.3)."""
        if self.round_trip_s is None:
            self.round_trip_s, self.deviation_s = round_trip_s, round_trip_s / 2.0
            return
        self.deviation_s += (abs(round_trip_s - self.round_trip_s) - self.deviation_s) / 4.0
        self.round_trip_s += (round_trip_s - self.round_trip_s) / 8.0

    def _patience_s(self, tries: int) -> float:
        low, high = _PATIENCE_LIMITS_S
        learnt = self.round_trip_s
        patience = _FIRST_PATIENCE_S if learnt is None else learnt + 4.0 * self.deviation_s
        return min(max(patience, low) * min(1.0 + 0.15 * (tries - 1), 1.5), high)

    def _most_tries(self) -> int:
        """Say after how many silent tries a name is given up, from the share of requests answered."""
        answered = (len(self.answers) + 3.0) / (self.sent + 4.0)
        tries = math.log(_FALSE_ABSENCE) / math.log(max(1.0 - answered, 1e-3))
        return min(max(math.ceil(tries), _FEWEST_TRIES), _MOST_TRIES)
