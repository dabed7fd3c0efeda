"""MAVLink's parameter protocol: read, write and prove parameters, and never trust an echo.

The protocol has no request numbers: a PARAM_VALUE may answer a read, echo a write, or be neither.
ArduPilot answers the write of an `_X` element with the current values of X, Y *and* Z. So a write is
believed when a value equal to the wanted one is heard, and proven by reading it once the echoes have
died away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mavcompass.errors import NoReply
from mavcompass.messages import ParamRequestRead
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.vehicle.parameters.exchange import Ask, Exchange
from mavcompass.vehicle.parameters.values import Encoding, Parameter, encode

SILENCE_S = 8.0  # a vehicle that says nothing at all for so long is not there
# A vehicle keeps its value if it was heard with it in so many tries: not all those writes were lost.
_REFUSED_TRIES = 7
_ROUNDS = 4


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
    asks = [Ask(name, (_read_request(context, name),), exists=exist) for name in dict.fromkeys(names)]
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
            Ask(name, (_read_request(context, name),), p.value, most_others=2) for name, p in wanted.items()
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
