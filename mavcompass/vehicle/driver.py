"""The driver: run a procedure on a link, and end it safely whatever happens.

The procedure neither sleeps nor reads a clock nor sends; this loop does it for it, speaks our heartbeat,
and turns Ctrl-C, SIGTERM, a silent vehicle and a lost link into a stop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic
from typing import Any, TypeVar, cast

from mavcompass.enums import MavType
from mavcompass.errors import LinkLost, NoReply, NoVehicle, Refused
from mavcompass.messages import Incoming
from mavcompass.procedure.script import (
    CLEAN_UP_S,
    Action,
    Answer,
    Ask,
    Event,
    Machine,
    Send,
    Show,
    Stop,
    Tick,
)
from mavcompass.procedure.vehicle_state import identify
from mavcompass.two_clocks import shared_id
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.lock import VehicleLock
from mavcompass.vehicle.stopping import StopRequest, stop_signals

T = TypeVar("T")
PollAnswer = Callable[[], bool | None]

HEARTBEAT_EVERY_S = 1.0
TICK_S = 0.05
# Heartbeats alone come once a second; on a link that loses a third, five in a row are one case in 250.
SILENCE_S = 5.0
_LONGEST_TURN_S = 4.0 * TICK_S
# Ctrl-C that often is an ending, not a person who does not know whether it was heard.
_PRESSES = 2
# A procedure that computes for a while catches up with what came meanwhile sooner.
_BEHIND_S = 3.0


def run(
    machine: Machine[T],
    link: Link,
    *,
    on_show: Callable[[Show], None] | None = None,
    on_message: Callable[[Incoming], None] | None = None,
    on_ask: Callable[[Ask], PollAnswer] | None = None,
    stop: StopRequest | None = None,
    silence_s: float = SILENCE_S,
) -> T:
    """Run a procedure to its end and return its result.

    Args:
        on_show: gets what the procedure has to tell. on_message: gets every message heard.
        on_ask: puts a question to the person and returns at once a function that tells the answer when
            there is one, else None; heartbeats and guards go on meanwhile. Without it the answer is no.
        stop: set its reason, from any thread, to end the procedure safely.
        silence_s: the vehicle counts as lost after saying nothing for so long.

    Raises whatever the procedure raises: Refused after a stop; LinkLost when the vehicle fell silent or
    the link broke for good, unless the procedure ended with something worse to tell, such as WriteFailed.
    """
    drive = _Drive(
        machine, link, on_show or (lambda _: None), on_ask or _refuse, stop or StopRequest(), silence_s
    )
    with VehicleLock(link.name) as lock, stop_signals(drive.stop):
        if link.shared:
            machine.context.hold = lock.hold
        while not machine.done:
            incoming = drive.turn()
            if incoming is not None and on_message is not None:
                on_message(incoming)
    if drive.lost is not None and type(machine.error) is Refused:
        raise drive.lost from machine.error
    if machine.error is not None:
        if isinstance(machine.error, NoVehicle | NoReply):
            machine.error.remedy = _what_the_link_shows(link) or machine.error.remedy
        raise machine.error
    return cast(T, machine.result)


def _what_the_link_shows(link: Link) -> str:
    """Say why vehicle and program may not understand each other, and what to do; "" if not known."""
    counts = link.statistics
    if (behind_s := link.behind_s()) > _BEHIND_S:
        return (
            f"For {behind_s:.0f} s more has come on {link.name} than this computer could read, so that"
            " answers were lost. Lower the rates of the vehicle's messages (SRn_*, MAV_n_RATE), or end"
            " what else keeps this computer busy, and run again."
        )
    if counts.refused:
        return (
            f"What came on {link.name} ({counts.refused} messages) was not signed with the key in use. Give"
            " the vehicle's own key with --sign-key FILE, or none if the vehicle does not sign."
        )
    if counts.signed:
        return (
            f"What comes on {link.name} is signed: the vehicle may believe only who signs, too. Give its key"
            " with --sign-key FILE."
        )
    return ""


def _refuse(question: Ask) -> PollAnswer:
    return lambda: False


class _Drive:
    """Be one run: what was said when, and why it has to stop."""

    def __init__(
        self,
        machine: Machine[Any],
        link: Link,
        on_show: Callable[[Show], None],
        on_ask: Callable[[Ask], PollAnswer],
        stop: StopRequest,
        silence_s: float,
    ) -> None:
        self.machine = machine
        self.link = link
        self.on_show = on_show
        self.on_ask = on_ask
        self.poll_answer: PollAnswer | None = None
        self.stop = stop
        self.silence_s = silence_s
        self.lost: LinkLost | None = None
        self._stopped, self._presses = False, 0
        self._last_s = self._next_heartbeat_s = link.now()
        self._listened_s = link.now()
        self._silent_s = 0.0

    def turn(self) -> Incoming | None:
        """Take the next event to the procedure and do what it asks for."""
        now_s = self.link.now()
        self.stop.noted_s = monotonic()
        if self.stop.reason is not None and not self._stopped:
            self._stop(self.stop.reason)
            return None
        if self.stop.presses > self._presses:
            self._press(self.stop.presses)
        if self.poll_answer is not None and (yes := self.poll_answer()) is not None:
            self.poll_answer = None
            self._step(Answer(now_s, yes))
            return None
        if now_s >= self._next_heartbeat_s:
            beat = self.link.identity.heartbeat()
            self.link.send(beat)
            if self.machine.context.as_station:
                self.link.send(replace(beat, type=MavType.GCS))
            self._next_heartbeat_s = now_s + HEARTBEAT_EVERY_S
        wake_s = min(self.machine.wake_at_s, self._next_heartbeat_s, now_s + TICK_S)
        try:
            incoming = self.link.receive(max(wake_s - now_s, 0.0))
        except LinkLost as error:
            self._end_without_link(error)
            return None
        self._step(Tick(self.link.now()) if incoming is None else incoming)
        self._watch_silence(incoming)
        self._watch_others(incoming)
        return incoming

    def _step(self, event: Event) -> None:
        # A message may have waited while a stop or an answer was taken in: time must not go back for it.
        self._last_s = max(self._last_s, event.time_s)
        self._do(self.machine.step(replace(event, time_s=self._last_s)))
        if self.machine.context.system:
            self.link.identity = self.link.identity.aboard(self.machine.context.system)

    def _do(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case Send(message):
                    self.link.send(message)
                case Show():
                    self.on_show(action)
                case Ask():
                    self.poll_answer = self.on_ask(action)

    def _stop(self, reason: str) -> None:
        self._stopped = True
        self._step(Stop(self.link.now(), reason))

    def _press(self, presses: int) -> None:
        """Heed a person who is impatient: the second time what goes on is said, the third time it is left."""
        self._presses = presses
        if presses > _PRESSES:
            self._do(self.machine.abandon())
        elif presses > 1:
            self.on_show(Show("end", "Ending safely; once more leaves everything as it stands."))

    def _watch_silence(self, incoming: Incoming | None) -> None:
        context = self.machine.context
        now_s = self.link.now()
        # Only time spent listening counts: what a busy or suspended computer slept through does not.
        self._silent_s += min(now_s - self._listened_s, _LONGEST_TURN_S)
        self._listened_s = now_s
        from_vehicle = incoming is not None and context.heard_from_vehicle(incoming) is not None
        # Finding no vehicle at all is the procedure's to tell.
        if from_vehicle or not context.system or now_s < context.silent_until_s:
            self._silent_s = 0.0
        if self._silent_s > self.silence_s and self.lost is None and not self.machine.done:
            sentence = f"has said nothing for {self._silent_s:.0f} s."
            self.lost = LinkLost(
                f"The vehicle on {self.link.name} {sentence}",
                "Bring the link back (power, cable, radio), then run again.",
            )
            self._stop(f"The vehicle {sentence}")

    def _watch_others(self, incoming: Incoming | None) -> None:
        """Tell of another vehicle that appears, and stop where it is another with the same system id."""
        context = self.machine.context
        if context.system in self.link.statistics.shared and not self._stopped:
            self._stop(" ".join(shared_id(context.system)))
        if context.alone and incoming is not None and incoming.system != context.system:
            if (other := identify(incoming)) is not None:
                context.alone = False
                which = f"system {other.system}, {other.autopilot} {other.kind}"
                goes_on = f"this goes on with system {context.system}."
                self.on_show(Show("connect", f"Another vehicle is on this link, too ({which}); {goes_on}"))

    def _end_without_link(self, error: LinkLost) -> None:
        """Let the procedure find out that nothing gets through any more, without waiting for it."""
        self.lost = error
        now_s = self.link.now()
        self._stop(error.what)
        end_s = now_s + 2.0 * CLEAN_UP_S
        while not self.machine.done and now_s < end_s:
            now_s += TICK_S
            self._step(Tick(now_s))
