"""Procedures that read like a story and never sleep, read a clock or touch a socket.

A `Script` is a generator: it yields the time at which it wants to be woken at the latest and is
resumed with the next `Event`. What it wants sent or shown it leaves with its `Context`. `Machine`
wraps a script into `step(event) -> actions`, so the same procedure runs on a serial line, on the
simulated vehicle in virtual time, inside another program and in tests.

A stop (the pilot, a failsafe, Ctrl-C) is thrown into the script as `Refused`; its `finally` blocks
run as any other part of it, so what was changed is put back over the wire before the script ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from mavcompass.errors import MavCompassError, NoReply, Refused
from mavcompass.messages import CommandLong, Incoming, Message

T = TypeVar("T")
M = TypeVar("M", bound=Message)

# After a stop a script has this long to put back what it changed.
CLEAN_UP_S = 20.0
# A request is waited for so long at first.
_PATIENCE_S = 0.7


@dataclass(frozen=True, slots=True)
class Tick:
    """Say that time has passed and nothing was heard."""

    time_s: float


@dataclass(frozen=True, slots=True)
class Stop:
    """Ask a procedure to end safely: `reason` is a sentence for the person."""

    time_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class Answer:
    """Bring the person's answer to the latest `Ask`."""

    time_s: float
    yes: bool


Event = Incoming | Tick | Stop | Answer
Script = Generator[float, Event, T]


@dataclass(frozen=True, slots=True)
class Send:
    """Ask the driver to send a message to the vehicle."""

    message: Message


@dataclass(frozen=True, slots=True)
class Show:
    """Tell the person what goes on.

    `step` is the procedure's phase (a word), `text` one sentence, `fraction` of the whole (or None),
    `data` figures for pages and progress bars, such as turned_deg.
    """

    step: str
    text: str
    fraction: float | None = None
    data: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Ask:
    """Ask the person a yes-or-no question; the driver brings an `Answer` when there is one.

    `about` is what to know before answering, a sentence each; `details` may be folded away.
    """

    question: str
    about: tuple[str, ...] = ()
    details: tuple[str, ...] = ()


Action = Send | Show | Ask


@dataclass(slots=True)
class Context:
    """Be a script's desk: the time, the vehicle it talks to, the tray for what goes out.

    Attributes:
        now: time of the event being handled, seconds on the link's clock.
        system, component: the vehicle's MAVLink address, 0 until it is known. heard_s: when it spoke last.
        listeners: called with every message from the vehicle before the script sees it.
        watches: called after each event with the time; a sentence stops the procedure.
        alone: the vehicle was taken because no other was heard; one that appears later is to be told.
        hold: keeps other programs off a vehicle until the procedure ends; its driver knows how.
        left: what could not be put back, told where the script is abandoned before it ends.
        as_station: beat as a ground station, too: PX4 tells its texts only where one is heard.
        silent_until_s: until then a silent vehicle is not a lost one: it restarts because we asked it to.
    """

    now: float = 0.0
    system: int = 0
    component: int = 0
    heard_s: float = -math.inf
    listeners: list[Callable[[Incoming], None]] = field(default_factory=list)
    watches: list[Callable[[float], str | None]] = field(default_factory=list)
    outbox: list[Action] = field(default_factory=list)
    alone: bool = False
    hold: Callable[[Any], None] = lambda _: None
    left: MavCompassError | None = None
    as_station: bool = False
    silent_until_s: float = -math.inf

    def send(self, message: Message) -> None:
        """Leave a message to be sent."""
        self.outbox.append(Send(message))

    def command(self, number: int, *params: float, attempt: int = 0) -> None:
        """Leave a COMMAND_LONG for the vehicle; a repeated one counts its attempts, as the protocol asks."""
        self.send(CommandLong(self.system, self.component, int(number), attempt, *map(float, params)))

    def show(self, step: str, text: str, fraction: float | None = None, **data: float) -> None:
        """Leave a line for the person."""
        self.outbox.append(Show(step, text, fraction, tuple(data.items())))

    @contextmanager
    def station(self, wanted: bool = True) -> Iterator[None]:
        """Beat as a ground station, too, for a while; see `as_station`."""
        self.as_station = wanted
        try:
            yield
        finally:
            self.as_station = False

    def heard_from_vehicle(self, event: Event) -> Incoming | None:
        """Return the event if it is a message of this script's vehicle (or none is chosen yet)."""
        if not isinstance(event, Incoming):
            return None
        if self.system and (event.system, event.component) != (self.system, self.component):
            return None
        return event


class Machine(Generic[T]):
    """Run a script one event at a time."""

    def __init__(self, script: Callable[[Context], Script[T]]) -> None:
        self.context = Context()
        self.done = False
        self.result: T | None = None
        self.error: BaseException | None = None
        self.wake_at_s = 0.0
        self._script = script(self.context)
        self._started = False
        self._stopped: tuple[float, Exception] | None = None

    def step(self, event: Event) -> list[Action]:
        """Take one event, return what is to be sent and shown. After `done` nothing happens."""
        if self.done:
            return []
        context = self.context
        context.now = event.time_s
        if not self._started:
            self._started = True
            self._resume(lambda: next(self._script))
        if isinstance(event, Stop):
            self._stop(Refused(event.reason))
        elif not self.done:
            error = self._look(event)
            if error is not None and self._stopped is None:
                self._stop(error)
            else:
                self._resume(lambda: self._script.send(event))
        if self._stopped is not None and context.now - self._stopped[0] > CLEAN_UP_S:
            return self.abandon()
        return self._actions()

    def _look(self, event: Event) -> Exception | None:
        """Let all listen and watch; return why to stop. A fault of theirs must not leave a vehicle moving."""
        context = self.context
        try:
            if (message := context.heard_from_vehicle(event)) is not None:
                context.heard_s = message.time_s
                for listener in context.listeners:
                    listener(message)
            if self._stopped is None:
                reason = next((r for w in list(context.watches) if (r := w(context.now))), None)
                return None if reason is None else Refused(reason)
        except Exception as fault:
            return fault
        return None

    def _stop(self, error: Exception) -> None:
        if self._stopped is None and not self.done:
            self._stopped = self.context.now, error
            self._resume(lambda: self._script.throw(error))

    def abandon(self) -> list[Action]:
        """End a stopped script that cannot clean up in time; it may say what it leaves behind."""
        why = "It was left." if self._stopped is None else self._stopped[1]
        try:
            with suppress(RuntimeError):  # it was still waiting in a `finally`
                self._script.close()
        except MavCompassError as what_is_left:
            self.context.left = self.context.left or what_is_left
        self._finish(
            None,
            self.context.left
            or Refused(
                f"{getattr(why, 'what', why)} What was changed could not all be put back.",
                "Look at the vehicle before you go near it.",
            ),
        )
        return self._actions()

    def _actions(self) -> list[Action]:
        actions, self.context.outbox = self.context.outbox, []
        return actions

    def _resume(self, advance: Callable[[], float]) -> None:
        try:
            self.wake_at_s = advance()
        except StopIteration as end:
            self._finish(end.value, None)
        except Exception as error:
            self._finish(None, error)

    def _finish(self, result: T | None, error: BaseException | None) -> None:
        if not self.done:
            self.done, self.result, self.error = True, result, error


# --- the words that scripts are made of ----------------------------------------------------------


def nothing(result: T) -> Script[T]:
    """Return at once."""
    yield from ()
    return result


def pause(context: Context, seconds: float) -> Script[None]:
    """Let time pass."""
    end = context.now + seconds
    while context.now < end:
        yield end


def expect(
    context: Context,
    kind: type[M],
    matches: Callable[[M], bool] = lambda _: True,
    timeout_s: float = 1.0,
) -> Script[M | None]:
    """Wait for a message of the vehicle; None when it did not come in time."""
    end = context.now + timeout_s
    while context.now < end:
        heard = context.heard_from_vehicle((yield end))
        # `type is`, not isinstance: SCALED_IMU2 is a subclass of SCALED_IMU.
        if heard is not None and type(heard.message) is kind and matches(heard.message):
            return heard.message
    return None


def request(
    context: Context,
    ask: Message,
    kind: type[M],
    matches: Callable[[M], bool] = lambda _: True,
    what: str = "a request",
    tries: int = 6,
) -> Script[M]:
    """Ask until answered, a little more patient each time.

    Raises NoReply after `tries` (0.7 + 1.05 + 1.4 ... seconds).
    """
    for attempt in range(tries):
        context.send(ask)
        patience = _PATIENCE_S * (1.0 + 0.5 * attempt)
        answer = yield from expect(context, kind, matches, patience)
        if answer is not None:
            return answer
    raise NoReply(
        f"The vehicle did not answer {what} ({tries} tries).",
        "Check the link; if it is slow or lossy, bring the radios closer and run again.",
    )


def ask(context: Context, question: Ask) -> Script[bool]:
    """Ask the person and wait for the answer, however long it takes."""
    context.outbox.append(question)
    while True:
        event = yield context.now + 1.0
        if isinstance(event, Answer):
            return event.yes
