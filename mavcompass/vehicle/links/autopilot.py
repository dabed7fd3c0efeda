"""What a link or a server needs of a vehicle that lives in this process."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from mavcompass.messages import Message
from mavcompass.vehicle.wire import Frame


class Said(Protocol):
    """Be a message that leaves a vehicle; `port` None is every port.

    `message` is None where a recording has one that this program does not use.
    """

    @property
    def time_s(self) -> float: ...
    @property
    def system(self) -> int: ...
    @property
    def component(self) -> int: ...
    @property
    def message(self) -> Message | None: ...
    @property
    def port(self) -> int | None: ...


@dataclass(frozen=True, slots=True)
class SaidMessage:
    """Be a message, plainly.

    Attributes:
        frame: what was recorded, which is sent on with its payload as it is.
    """

    time_s: float
    system: int
    component: int
    message: Message | None
    port: int | None = None
    frame: Frame | None = None


class Autopilot(Protocol):
    """Be a simulated flight controller, or one that replays."""

    @property
    def time_s(self) -> float:
        """Return its virtual time, seconds; never goes back."""

    def receive(self, message: Message, system: int, component: int, port: int) -> None:
        """Hear a message now."""

    def advance(self, until_s: float) -> Sequence[Said]:
        """Live until then and return what was said, in order."""


class Recorded(Autopilot, Protocol):
    """Be the vehicle of a recording, which comes to an end."""

    def advance(self, until_s: float) -> Sequence[SaidMessage]:
        """Live until then and return what was said, in order."""

    @property
    def ended(self) -> bool:
        """Tell whether everything has been said."""


class Pace:
    """Keep virtual time from running ahead of the wall clock; `speed` 2 is twice real time."""

    def __init__(self, speed: float, virtual_s: float) -> None:
        self._speed = speed
        self._virtual_s = virtual_s
        self._wall_s = time.monotonic()

    def virtual_now(self) -> float:
        """Return the virtual time that has been reached by now."""
        return self._virtual_s + (time.monotonic() - self._wall_s) * self._speed

    def sleep_until(self, virtual_s: float) -> None:
        """Wait for the wall clock."""
        ahead_s = (virtual_s - self.virtual_now()) / self._speed
        if ahead_s > 0.0:
            time.sleep(ahead_s)
