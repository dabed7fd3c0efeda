"""Any link, or the vehicle of a recording, made worse: loss, duplication, reordering, latency, and a cut."""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import dataclass, replace
from itertools import count
from typing import Generic, TypeVar

from mavcompass.errors import LinkLost
from mavcompass.messages import Incoming, Message
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.links.autopilot import Recorded, SaidMessage

T = TypeVar("T")


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

    @property
    def loss_of_ours(self) -> float:
        """Return the probability of losing a message sent."""
        return self.loss if self.loss_out is None else self.loss_out

    def is_cut(self, time_s: float) -> bool:
        """Tell whether nothing gets through at a time."""
        return self.cut_at_s <= time_s < self.restored_at_s


class FaultyLink(Link):
    """Wrap a link; with a virtual one the faults happen in virtual time, the same for the same seed."""

    def __init__(self, link: Link, faults: Faults, seed: int) -> None:
        super().__init__(f"{link.name} (faulty)", link.identity)
        self._link = link
        self.faults = faults
        self._coming = _Way[Incoming](faults, faults.loss, f"in {seed}")
        self._going = _Way[Message](faults, faults.loss_of_ours, f"out {seed}")

    def now(self) -> float:
        """Return the wrapped link's time."""
        return self._link.now()

    def send(self, message: Message) -> None:
        """Send, perhaps."""
        self._going.set_out(self.now(), message)
        self._send_due()

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message that gets through; see Link."""
        deadline_s = self.now() + timeout_s
        while True:
            self._send_due()
            now_s = self.now()
            if self.faults.is_cut(now_s) and self.faults.cut_is_final:
                raise LinkLost(f"{self.name} was cut.")
            if self._coming.next_s <= now_s:
                time_s, incoming = self._coming.take()
                self.statistics.received += 1
                return replace(incoming, time_s=time_s)
            if now_s >= deadline_s:
                return None
            self._listen(min(deadline_s, self._next_event_s()) - now_s)

    def close(self) -> None:
        """Close the wrapped link."""
        self._link.close()

    def _next_event_s(self) -> float:
        cut_s = self.faults.cut_at_s
        return min(self._coming.next_s, self._going.next_s, cut_s if cut_s > self.now() else math.inf)

    def _listen(self, timeout_s: float) -> None:
        incoming = self._link.receive(max(timeout_s, 0.0))
        if incoming is not None:
            self._coming.set_out(incoming.time_s, incoming)

    def _send_due(self) -> None:
        now_s = self.now()
        while self._going.next_s <= now_s:
            _, message = self._going.take()
            if not self.faults.is_cut(now_s):
                self._link.identity = self.identity
                self._link.send(message)


class FaultyRecording:
    """Wrap the vehicle of a recording; the faults are the same for the same seed."""

    def __init__(self, recorded: Recorded, faults: Faults, seed: int) -> None:
        self._recorded = recorded
        self._coming = _Way[SaidMessage](faults, faults.loss, f"in {seed}")
        self._going = _Way[tuple[Message, int, int, int]](faults, faults.loss_of_ours, f"out {seed}")

    @property
    def time_s(self) -> float:
        """Return the recording's time."""
        return self._recorded.time_s

    @property
    def ended(self) -> bool:
        """Tell whether everything has been said and has arrived."""
        return self._recorded.ended and self._coming.next_s == math.inf

    def receive(self, message: Message, system: int, component: int, port: int) -> None:
        """Hear a message, perhaps, and later."""
        self._going.set_out(self.time_s, (message, system, component, port))

    def advance(self, until_s: float) -> list[SaidMessage]:
        """Play up to then; what arrives later is kept."""
        while self._going.next_s <= until_s:
            time_s, heard = self._going.take()
            self._play(time_s)
            self._recorded.receive(*heard)
        self._play(until_s)
        arrived: list[SaidMessage] = []
        while self._coming.next_s <= until_s:
            time_s, played = self._coming.take()
            arrived.append(replace(played, time_s=time_s))
        return arrived

    def _play(self, until_s: float) -> None:
        for played in self._recorded.advance(max(until_s, self.time_s)):
            self._coming.set_out(played.time_s, played)


class _Way(Generic[T]):
    """Be one direction: what is under way, each with the time of its arrival."""

    def __init__(self, faults: Faults, loss: float, seed: str) -> None:
        self._faults = faults
        self._loss = loss
        self._chance = random.Random(seed)
        self._order = count()  # keeps equal times in order
        self._under_way: list[tuple[float, int, T]] = []

    @property
    def next_s(self) -> float:
        """Return when the next one arrives; infinite for none."""
        return self._under_way[0][0] if self._under_way else math.inf

    def take(self) -> tuple[float, T]:
        """Return the next arrival, with its time."""
        time_s, _, thing = heapq.heappop(self._under_way)
        return time_s, thing

    def set_out(self, time_s: float, thing: T) -> None:
        """Send a thing on its way; it arrives once, twice, late or never."""
        faults, chance = self._faults, self._chance
        if chance.random() < self._loss or faults.is_cut(time_s):
            return
        copies = 2 if chance.random() < faults.duplicate else 1
        held_back_s = faults.jitter_s * chance.random() if chance.random() < faults.reorder else 0.0
        for _ in range(copies):
            arrives_s = time_s + faults.latency_s + held_back_s
            heapq.heappush(self._under_way, (arrives_s, next(self._order), thing))
