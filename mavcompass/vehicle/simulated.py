"""SimulatedLink: a simulated vehicle inside this process, in virtual time and without sockets."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

from mavcompass.errors import LinkLost
from mavcompass.messages import Incoming, Message
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link

# The vehicle is advanced in pieces of this length, which is therefore how long an answer takes at most.
STEP_S = 0.01


class Said(Protocol):
    """Be a message that leaves a simulated vehicle; `port` None is every port."""

    @property
    def time_s(self) -> float: ...
    @property
    def system(self) -> int: ...
    @property
    def component(self) -> int: ...
    @property
    def message(self) -> Message: ...
    @property
    def port(self) -> int | None: ...


class Autopilot(Protocol):
    """Be a simulated flight controller: `mavcompass.simulation.SimulatedAutopilot`, or one that replays."""

    @property
    def time_s(self) -> float:
        """Return its virtual time, seconds; never goes back."""

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Hear a message now."""

    def advance(self, until_s: float) -> Sequence[Said]:
        """Live until then and return what was said, in order."""


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


class SimulatedLink(Link):
    """Speak with a simulated vehicle. Its time passes only while `receive` waits.

    Attributes:
        autopilot: the vehicle, for looking at its truth and for playing the pilot in tests.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        name: str = "sim",
        identity: Identity = ONBOARD_COMPUTER,
        speed: float | None = None,
        port: int = 0,
    ) -> None:
        super().__init__(name, identity)
        self.autopilot = autopilot
        self._port = port
        self._pace = None if speed is None else Pace(speed, autopilot.time_s)
        self._now_s = autopilot.time_s
        self._heard: deque[Incoming] = deque()
        self._closed = False

    @classmethod
    def of(
        cls,
        vehicle: str,
        *,
        seed: int = 0,
        effects: Sequence[Any] = (),
        identity: Identity = ONBOARD_COMPUTER,
        speed: float | None = None,
    ) -> SimulatedLink:
        """Make a vehicle and the link to it. Raises UsageError for an unknown vehicle or effect."""
        from mavcompass.simulation.autopilot import SimulatedAutopilot

        autopilot = SimulatedAutopilot(vehicle, seed=seed, effects=effects)
        return cls(autopilot, f"sim:{vehicle},seed={seed}", identity, speed)

    def now(self) -> float:
        """Return the virtual time."""
        return self._now_s

    def send(self, message: Message) -> None:
        """Let the vehicle hear a message."""
        if self._closed:
            self.statistics.dropped += 1
            return
        self.autopilot.receive(message, self.identity.spoken_system, self.identity.component, self._port)

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next message; see Link."""
        deadline_s = self._now_s + timeout_s
        while not self._closed:
            if self._heard and self._heard[0].time_s <= deadline_s:
                incoming = self._heard.popleft()
                self._now_s = max(self._now_s, incoming.time_s)
                self.statistics.received += 1
                return incoming
            if self._heard or self.autopilot.time_s >= deadline_s:
                break
            self._advance(min(self.autopilot.time_s + STEP_S, deadline_s))
        self._now_s = max(self._now_s, deadline_s)
        if self._closed:
            raise LinkLost(f"{self.name} is closed.")
        return None

    def close(self) -> None:
        """Part from the vehicle."""
        self._closed = True

    def _advance(self, until_s: float) -> None:
        for said in self.autopilot.advance(until_s):
            if said.port is None or said.port == self._port:
                self._heard.append(Incoming(said.time_s, said.system, said.component, said.message))
        if self._pace is not None:
            self._pace.sleep_until(until_s)
