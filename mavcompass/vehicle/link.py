"""Link: the one way to a vehicle, whether it is real, simulated or recorded.

A link has three verbs: receive, send, close. It owns the clock: `now` is monotonic wall time on a live
link and virtual time on a simulated or replayed one, so nothing above it ever sleeps or reads a clock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Self

from mavcompass.enums import (
    COMPONENT_GROUND_STATION,
    COMPONENT_ONBOARD_COMPUTER,
    MavAutopilot,
    MavState,
    MavType,
)
from mavcompass.errors import LinkLost
from mavcompass.messages import Heartbeat, Incoming, Message
from mavcompass.two_clocks import TwoClocks


@dataclass(frozen=True, slots=True)
class Identity:
    """Say who we are on the link: MAVLink system, component, and the type in our heartbeat.

    System 0 means "that of the vehicle": a companion computer is a component of the vehicle it sits in.
    Until the vehicle is known it speaks as `GUESSED_SYSTEM`, which is what nearly all vehicles are.
    """

    system: int
    component: int
    type: int

    GUESSED_SYSTEM = 1

    @property
    def spoken_system(self) -> int:
        """Return the system id to send with."""
        return self.system or self.GUESSED_SYSTEM

    def aboard(self, vehicle_system: int) -> Identity:
        """Take the vehicle's system id, unless this identity has its own."""
        return self if self.system else replace(self, system=vehicle_system)

    def heartbeat(self) -> Heartbeat:
        """Say that we are here; routers only send to those they have heard."""
        return Heartbeat(type=self.type, autopilot=MavAutopilot.INVALID, system_status=MavState.ACTIVE)


ONBOARD_COMPUTER = Identity(0, COMPONENT_ONBOARD_COMPUTER, MavType.ONBOARD_CONTROLLER)
GROUND_STATION = Identity(255, COMPONENT_GROUND_STATION, MavType.GCS)


@dataclass(slots=True)
class SourceStatistics:
    """Count the frames of one sender: `lost` and `late` by its sequence numbers.

    `late` are frames that came again or out of order.
    """

    received: int = 0
    lost: int = 0
    late: int = 0
    clocks: TwoClocks = field(default_factory=TwoClocks)
    _last_sequence: int | None = None

    # A step back by more than this is a sender that started again, not a frame that was overtaken.
    _REORDER_WINDOW = 16

    def goes_on(self, sequence: int) -> bool:
        """Tell whether a frame of this number is the next one."""
        return self._last_sequence is not None and sequence == (self._last_sequence + 1) & 0xFF

    def count(self, sequence: int) -> None:
        """Take in the next frame's sequence number, 0..255."""
        self.received += 1
        if self._last_sequence is not None:
            gap = (sequence - self._last_sequence - 1) & 0xFF
            if gap >= 256 - self._REORDER_WINDOW:
                self.late += 1
                return
            self.lost += gap if gap < 128 else 0
        self._last_sequence = sequence


@dataclass(slots=True)
class LinkStatistics:
    """Count what came and what did not.

    Attributes:
        received: messages handed out. malformed: stretches of bytes that were no frame, or a frame whose
            checksum or signature was wrong. unknown: whole frames of messages that this program does not use.
        signed: frames with a signature that was not looked at, no key being in use. refused: good frames
            without a signature by the key in use.
        dropped: messages that could not be sent.
        sources: by (system, component). shared: system ids with which two autopilots speak: their clocks go
            back and forth, and so do their sequence numbers.
    """

    received: int = 0
    malformed: int = 0
    unknown: int = 0
    signed: int = 0
    refused: int = 0
    dropped: int = 0
    sources: dict[tuple[int, int], SourceStatistics] = field(default_factory=dict)
    shared: set[int] = field(default_factory=set)

    @property
    def lost(self) -> int:
        """Return the number of frames missing by their senders' sequence numbers."""
        return sum(source.lost for source in self.sources.values())

    def count(self, system: int, component: int, sequence: int, message: Message | None = None) -> None:
        """Take in one good frame, and the message in it where this program uses that."""
        source = self.sources.get((system, component))
        if source is None:
            source = self.sources[system, component] = SourceStatistics()
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is not None:
            source.clocks.hear(type(message), boot_ms * 1e-3, source.goes_on(sequence))
            if source.clocks.seen:
                self.shared.add(system)
        source.count(sequence)


class Link(ABC):
    """Be a way to a vehicle: iterate what is heard, send, close. Also a context manager.

    Attributes:
        name: the address, for messages to people.
        identity: who we are; set it once the vehicle is known (`Identity.aboard`).
        statistics: what came and what did not.
        shared: other programs may reach the vehicle, too.
    """

    shared = False

    def __init__(self, name: str, identity: Identity = ONBOARD_COMPUTER) -> None:
        self.name = name
        self.identity = identity
        self.statistics = LinkStatistics()

    @abstractmethod
    def now(self) -> float:
        """Return the time on this link's clock, seconds; it never goes back."""

    def behind_s(self) -> float:
        """Return for how long already more has come than was read; answers get lost meanwhile."""
        return 0.0

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send a message, without waiting; what cannot be sent is counted as dropped."""

    @abstractmethod
    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message heard, or None when none came within `timeout_s` of the link's time.

        Messages come in the order of their times, which are those of their arrival.
        Raises LinkLost when the other end is gone for good, once everything it said has been handed out.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the port or socket; calling it again does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Incoming]:
        """Hand out every message until the other end is gone for good."""
        while True:
            try:
                incoming = self.receive(1.0)
            except LinkLost:
                return
            if incoming is not None:
                yield incoming
