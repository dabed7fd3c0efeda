"""MAVLink's parameter protocol: read, write and prove parameters, many at once, and never trust an echo.

The protocol has no request numbers: a PARAM_VALUE may answer a read, echo a write, or be neither. ArduPilot
answers the write of an `_X` element with the current values of X, Y *and* Z. So a write is believed when a
value equal to the wanted one is heard, and proven by reading it once the echoes have died away.

Nor does it say anything about names that do not exist. So a name counts as absent when it stayed silent for
as many tries as a name that exists would not, judged by how often the others answered, while the vehicle was
heard otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mavcompass.errors import LinkLost, NoReply
from mavcompass.messages import Message, ParamRequestRead, ParamValue
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.vehicle.parameters.values import Encoding, Parameter, decode, encode, holds

SILENCE_S = 8.0  # a vehicle that says nothing at all for so long is not there
# A vehicle keeps its value if it was heard with it in so many tries: not all those writes were lost.
_REFUSED_TRIES = 7
_ROUNDS = 4

WINDOW = 12  # requests under way at once; ArduPilot's own queue holds 20
_FIRST_PATIENCE_S = 0.8
_PATIENCE_LIMITS_S = (0.25, 3.0)
_SHORTEST_LATENESS_S = 0.1
_FALSE_ABSENCE = 1e-5  # probability of calling a parameter absent that exists
_FEWEST_TRIES, _MOST_TRIES = 4, 25


class ValueRefused(NoReply):
    """Report a vehicle that answers a write by keeping another value."""


def read(
    context: Context,
    names: Sequence[str],
    encoding: Encoding,
    enough: Callable[[Mapping[str, Parameter]], bool] = lambda _: False,
    exist: bool = False,
) -> Script[dict[str, Parameter]]:
    """Read parameters by name, several at a time; a name that the vehicle does not know is left out.

    `enough` may end the reading early, given what was heard so far. Names that are known to `exist` are
    asked for longer. Raises LinkLost where the vehicle says nothing at all for `SILENCE_S`.
    """
    asks = [Ask(name, (_read_request(context, name),), exist) for name in dict.fromkeys(names)]
    exchange = Exchange(context, encoding, asks)
    yield from exchange.run(SILENCE_S, enough)
    return {name: exchange.answers[name] for name in names if name in exchange.answers}


def write(
    context: Context, wanted: Mapping[str, Parameter], encoding: Encoding, silence_s: float = SILENCE_S
) -> Script[float]:
    """Write parameters until each is heard with its wanted value; return how long echoes may linger, in s.

    Raises ValueRefused where the vehicle keeps another value, NoReply where it does not answer, LinkLost
    where it says nothing at all for `silence_s`.
    """
    asks = [
        Ask(
            name,
            (encode(name, p, encoding, context),),
            True,
            p.value,
            again=(_read_request(context, name),),
            most_others=_REFUSED_TRIES,
        )
        for name, p in wanted.items()
    ]
    exchange = Exchange(context, encoding, asks)
    yield from exchange.run(silence_s)
    for ask in asks:
        if ask.name not in exchange.answers:
            raise _failure(ask, "took")
    return exchange.lateness_s()


def prove(
    context: Context,
    wanted: Mapping[str, Parameter],
    encoding: Encoding,
    echoes_s: float,
    silence_s: float = SILENCE_S,
) -> Script[None]:
    """Prove by reading that the vehicle holds these values, once the echoes of writing have died away.

    A late echo may have vouched for a write that was lost, and a late write may have undone another:
    what reads differently is written again, and all is read once more. `echoes_s` is what `write`
    returned. Raises ValueRefused where the vehicle holds another value, otherwise as `write`.
    """
    for _ in range(_ROUNDS):
        yield from pause(context, echoes_s)
        asks = [
            Ask(name, (_read_request(context, name),), True, p.value, most_others=2)
            for name, p in wanted.items()
        ]
        exchange = Exchange(context, encoding, asks)
        yield from exchange.run(silence_s)
        differing = [ask for ask in asks if ask.name not in exchange.answers]
        if not differing:
            return
        if any(ask.other_value is None for ask in differing):
            break
        again = {ask.name: wanted[ask.name] for ask in differing}
        echoes_s = yield from write(context, again, encoding, silence_s)
    raise _failure(differing[0], "gave")


def _read_request(context: Context, name: str) -> ParamRequestRead:
    return ParamRequestRead(context.system, context.component, name)


def _failure(ask: Ask, verb: str) -> NoReply:
    if ask.other_value is not None:
        return ValueRefused(
            f"The vehicle keeps {ask.name} at {ask.other_value:g} instead of {ask.wanted:g}.",
            "Check that nobody else is changing parameters, and that the value is within its range.",
        )
    return NoReply(
        f"The vehicle never {verb} {ask.name} ({ask.tries} tries).",
        "Check the link; if it is slow or lossy, bring the radios closer and run again.",
    )


# --- many dialogues at once -----------------------------------------------------------------------


@dataclass(slots=True)
class Ask:
    """Be one name's dialogue: what is sent, which value ends it (None: any), how it stands."""

    name: str
    first: tuple[Message, ...]
    exists: bool  # its silence is the link's
    wanted: float | None = None
    again: tuple[Message, ...] = ()  # sent beside `first` from the second try on
    most_others: float = math.inf  # so many tries with another value are the vehicle's word
    tries: int = 0
    first_s: float = field(init=False)
    sent_s: float = field(init=False)
    due_s: float = -math.inf
    others: set[int] = field(default_factory=set)  # tries in which another value than the wanted was heard
    other_value: float | None = None

    def hear_other(self, value: float) -> None:
        """Note a value that is not the wanted one: a late echo, a lost write, or a refusal."""
        self.others.add(self.tries)
        self.other_value = value

    def refused(self) -> bool:
        """Tell whether another value came too often to be an echo or the sign of a lost write."""
        return len(self.others) >= self.most_others


class Exchange:
    """Carry on many dialogues at once, with a patience learnt from the answers."""

    def __init__(self, context: Context, encoding: Encoding, asks: Iterable[Ask]) -> None:
        self.context = context
        self.encoding = encoding
        self.open = {ask.name: ask for ask in asks}
        self.answers: dict[str, Parameter] = {}
        self.sent = 0  # how often the names that answered had been asked
        self.heard_s = context.now
        self.round_trip_s: float | None = None
        self.deviation_s: float  # known with the round trip

    def run(
        self, silence_s: float, enough: Callable[[Mapping[str, Parameter]], bool] = lambda _: False
    ) -> Script[None]:
        """Ask until every name has answered or is given up. Raises LinkLost for a silent vehicle."""
        context, wake_s = self.context, -math.inf
        while self.open:
            if context.now >= wake_s:
                wake_s = self._ask()
                if not self.open:
                    return
            event = yield min(wake_s, self.heard_s + silence_s)
            if (heard := context.heard_from_vehicle(event)) is not None:
                self.heard_s = context.now
                if self._take(heard.message):
                    wake_s = -math.inf  # room for the next name
                    if enough(self.answers):
                        return
            elif context.now >= self.heard_s + silence_s:
                raise LinkLost(
                    f"The vehicle has been silent for {silence_s:g} s.",
                    "Bring the link back (power, cable, radio), then run again.",
                )

    def _ask(self) -> float:
        """Send what is due within the window; return when to look again."""
        now = self.context.now
        for ask in [a for a in self.open.values() if a.tries and a.due_s <= now]:
            # Silence says nothing about a name while the vehicle says nothing at all.
            alive = self.heard_s > ask.first_s
            if alive and (ask.refused() or ask.tries >= self._most_tries(ask)):
                del self.open[ask.name]
        under_way = sum(1 for ask in self.open.values() if ask.due_s > now)
        for ask in [a for a in self.open.values() if a.due_s <= now][: max(0, WINDOW - under_way)]:
            for message in ask.first + (ask.again if ask.tries else ()):
                self.context.send(message)
            if not ask.tries:
                ask.first_s = now
            ask.tries += 1
            ask.sent_s, ask.due_s = now, now + self._interval_s(ask)
        return min((ask.due_s for ask in self.open.values() if ask.due_s > now), default=now)

    def _take(self, message: Message) -> bool:
        """Use a PARAM_VALUE that was waited for; tell whether it ended a dialogue."""
        if not isinstance(message, ParamValue):
            return False
        ask = self.open.get(message.param_id)
        if ask is None or not ask.tries:
            return False
        parameter = decode(message, self.encoding)
        if ask.wanted is not None and not holds(parameter, ask.wanted, self.encoding):
            ask.hear_other(parameter.value)
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

    def patience_s(self) -> float:
        """Say how long to wait for the answer to a request."""
        return max(self.lateness_s(), _PATIENCE_LIMITS_S[0])

    def lateness_s(self) -> float:
        """Say how long after its request an answer may come (RFC 6298, equation 2.3)."""
        if self.round_trip_s is None:
            return _FIRST_PATIENCE_S
        late_s = self.round_trip_s + 4.0 * self.deviation_s
        return min(max(late_s, _SHORTEST_LATENESS_S), _PATIENCE_LIMITS_S[1])

    def _interval_s(self, ask: Ask) -> float:
        """Say when to ask again: where half of the requests are lost, twice as often as they answer.

        The first answer is waited for in full, as it tells the round trip, and so is the last.
        """
        if ask.tries == 1 or ask.tries >= self._most_tries(ask):
            return self.patience_s()
        return max(self.patience_s() * self._answered(), _PATIENCE_LIMITS_S[0])

    def _answered(self) -> float:
        """Estimate the share of requests that are answered; a link is trusted until it shows otherwise."""
        return (len(self.answers) + 3.0) / (self.sent + 4.0)

    def _most_tries(self, ask: Ask) -> int:
        """Say after how many silent tries a name is given up, from the share of requests answered."""
        if ask.exists:
            return _MOST_TRIES
        share = self._answered()
        if self.sent:  # less one standard deviation: the first answers may have been lucky
            share -= math.sqrt(share * (1.0 - share) / (self.sent + 4.0))
        tries = math.log(_FALSE_ABSENCE) / math.log(max(1.0 - share, 1e-3))
        return min(max(math.ceil(tries), _FEWEST_TRIES), _MOST_TRIES)
