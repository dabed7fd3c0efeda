"""Any link, or the vehicle of a recording, made worse: loss, duplication, reordering, latency, and a cut."""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import dataclass, replace
from itertools import count

from mavcompass.errors import LinkLost
from mavcompass.messages import Incoming, Message
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.links.autopilot import Played, Recorded


@dataclass(frozen=True, slots=True)
class Faults:
    """Say how bad a link is; the probabilities hold for each message and each way.

    Attributes:
        loss, loss_out: probability of losing a message heard, and sent (None: the same).
        duplicate: probability of a message coming twice. reorder: of being held back by up to `jitter_s`.
        latency_s: delay each way.
        cut_at_s: time on the link's clock from which nothing gets through; `cut_is_final` says whether that
            is noticed (LinkLost, as a closed connection) or mere silence (as a radio out of reach).
        restored_at_s: time from which it works again.
    """

    loss: float = 0.0
    loss_out: float | None = None
    duplicate: float = 0.0
    reorder: float = 0.0
    latency_s: float = 0.0
    jitter_s: float = 0.2
    cut_at_s: float = math.inf
    cut_is_final: bool = False
    restored_at_s: float = math.inf

    def is_cut(self, time_s: float) -> bool:
        """Tell whether nothing gets through at a time."""
        return self.cut_at_s <= time_s < self.restored_at_s


class FaultyLink(Link):
    """Wrap a link; with a virtual one the faults happen in virtual time, the same for the same seed."""

    def __init__(self, link: Link, faults: Faults, seed: int = 0) -> None:
        super().__init__(f"{link.name} (faulty)", link.identity)
        self._link = link
        self.faults = faults
        self._chances = _Chances(seed)
        self._coming: list[tuple[float, int, Incoming]] = []
        self._going: list[tuple[float, int, Message]] = []

    def now(self) -> float:
        """Return the wrapped link's time."""
        return self._link.now()

    def send(self, message: Message) -> None:
        """Send, perhaps."""
        loss = self.faults.loss if self.faults.loss_out is None else self.faults.loss_out
        for time_s in self._chances.out(self.faults, loss, self.now()):
            heapq.heappush(self._going, (time_s, self._chances.next(), message))
        self._send_due()

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message that gets through; see Link."""
        deadline_s = self.now() + timeout_s
        while True:
            self._send_due()
            now_s = self.now()
            if self.faults.is_cut(now_s) and self.faults.cut_is_final:
                raise LinkLost(f"{self.name} was cut.")
            if self._coming and self._coming[0][0] <= now_s:
                time_s, _, incoming = heapq.heappop(self._coming)
                self.statistics.received += 1
                return replace(incoming, time_s=time_s)
            if now_s >= deadline_s:
                return None
            self._listen(min(deadline_s, self._next_event_s()) - now_s)

    def close(self) -> None:
        """Close the wrapped link."""
        self._link.close()

    def _next_event_s(self) -> float:
        due = [queue[0][0] for queue in (self._coming, self._going) if queue]
        cut_s = self.faults.cut_at_s
        return min([*due, cut_s if cut_s > self.now() else math.inf])

    def _listen(self, timeout_s: float) -> None:
        incoming = self._link.receive(max(timeout_s, 0.0))
        if incoming is not None:
            for time_s in self._chances.into(self.faults, self.faults.loss, incoming.time_s):
                heapq.heappush(self._coming, (time_s, self._chances.next(), incoming))

    def _send_due(self) -> None:
        now_s = self.now()
        while self._going and self._going[0][0] <= now_s:
            _, _, message = heapq.heappop(self._going)
            if not self.faults.is_cut(now_s):
                self._link.identity = self.identity
                self._link.send(message)


class FaultyRecording:
    """Wrap the vehicle of a recording; the faults are the same for the same seed."""

    def __init__(self, recorded: Recorded, faults: Faults, seed: int = 0) -> None:
        self._recorded = recorded
        self._faults = faults
        self._chances = _Chances(seed)
        self._coming: list[tuple[float, int, Played]] = []
        self._going: list[tuple[float, int, tuple[Message, int, int, int]]] = []

    @property
    def time_s(self) -> float:
        """Return the recording's time."""
        return self._recorded.time_s

    @property
    def ended(self) -> bool:
        """Tell whether everything has been said and has arrived."""
        return self._recorded.ended and not self._coming

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Hear a message, perhaps, and later."""
        loss = self._faults.loss if self._faults.loss_out is None else self._faults.loss_out
        for time_s in self._chances.out(self._faults, loss, self.time_s):
            heapq.heappush(self._going, (time_s, self._chances.next(), (message, system, component, port)))

    def advance(self, until_s: float) -> list[Played]:
        """Play up to then; what arrives later is kept."""
        while self._going and self._going[0][0] <= until_s:
            time_s, _, heard = heapq.heappop(self._going)
            self._play(time_s)
            self._recorded.receive(*heard)
        self._play(until_s)
        arrived: list[Played] = []
        while self._coming and self._coming[0][0] <= until_s:
            time_s, _, played = heapq.heappop(self._coming)
            arrived.append(replace(played, time_s=time_s))
        return arrived

    def _play(self, until_s: float) -> None:
        for played in self._recorded.advance(max(until_s, self.time_s)):
            for time_s in self._chances.into(self._faults, self._faults.loss, played.time_s):
                heapq.heappush(self._coming, (time_s, self._chances.next(), played))


class _Chances:
    """Throw the dice, one pair for each direction."""

    def __init__(self, seed: int) -> None:
        self._in, self._out = random.Random(f"in {seed}"), random.Random(f"out {seed}")
        self._order = count()

    def next(self) -> int:
        """Return a number that keeps equal times in order."""
        return next(self._order)

    def into(self, faults: Faults, loss: float, time_s: float) -> list[float]:
        """Return the times at which a message that is heard arrives: none, one or two."""
        return _fates(self._in, faults, loss, time_s)

    def out(self, faults: Faults, loss: float, time_s: float) -> list[float]:
        """Return the times at which a message that is sent arrives."""
        return _fates(self._out, faults, loss, time_s)


def _fates(chance: random.Random, faults: Faults, loss: float, time_s: float) -> list[float]:
    if chance.random() < loss or faults.is_cut(time_s):
        return []
    copies = 2 if chance.random() < faults.duplicate else 1
    held_back_s = faults.jitter_s * chance.random() if chance.random() < faults.reorder else 0.0
    return [time_s + faults.latency_s + held_back_s] * copies
