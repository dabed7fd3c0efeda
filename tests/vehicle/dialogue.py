"""A vehicle that follows a script: tests of a dialogue read like the page of the protocol's manual.

    with vehicle_script(Expect(ParamSet(...)), Reply(ParamValue(...))) as link:
        ...

The vehicle beats its heart once a second and ignores ours. A message that the script does not expect fails
the test at once; what is left of the script at the end fails it too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from mavcompass.enums import MavAutopilot, MavType
from mavcompass.messages import Heartbeat, Message
from mavcompass.vehicle.links.simulated import SimulatedLink

HEARTBEAT = Heartbeat(type=MavType.GROUND_ROVER, autopilot=MavAutopilot.ARDUPILOTMEGA)


@dataclass(frozen=True)
class Said:
    time_s: float
    system: int
    component: int
    message: Message
    port: int | None = None


@dataclass(frozen=True)
class Expect:
    """Wait for exactly this message; the target may be left out."""

    message: Message


@dataclass(frozen=True)
class Reply:
    """Say this, `after_s` after the step before."""

    message: Message
    after_s: float = 0.005


@dataclass(frozen=True)
class Silence:
    """Stop the heartbeat from here on."""


Step = Expect | Reply | Silence


class MemoryVehicle:
    """Be a vehicle in virtual time: it says what it is told to, and keeps what it hears."""

    def __init__(self, system: int = 1, component: int = 1, beats: bool = True) -> None:
        self.time_s = 0.0
        self.system, self.component = system, component
        self.beats = beats
        self.heard: list[tuple[int, int, Message]] = []
        self._next_beat_s = 0.0
        self._due: deque[Said] = deque()

    def say(self, message: Message, after_s: float = 0.0) -> None:
        self._due.append(Said(self.time_s + after_s, self.system, self.component, message))

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        self.heard.append((system, component, message))

    def advance(self, until_s: float) -> list[Said]:
        said = [s for s in self._due if s.time_s <= until_s]
        self._due = deque(s for s in self._due if s.time_s > until_s)
        while self.beats and self._next_beat_s <= until_s:
            said.append(Said(self._next_beat_s, self.system, self.component, HEARTBEAT))
            self._next_beat_s += 1.0
        self.time_s = until_s
        return sorted(said, key=lambda s: s.time_s)


class ScriptedVehicle(MemoryVehicle):
    """Follow a script."""

    def __init__(self, steps: tuple[Step, ...]) -> None:
        super().__init__()
        self.left = deque(steps)
        self._go_on()

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        if isinstance(message, Heartbeat):
            return
        super().receive(message, system, component, port)
        assert self.left, f"the script is over, yet the vehicle hears {message}"
        step = self.left.popleft()
        assert isinstance(step, Expect)
        assert _without_target(message, step.message) == step.message
        self._go_on()

    def _go_on(self) -> None:
        after_s = 0.0
        while self.left and not isinstance(self.left[0], Expect):
            step = self.left.popleft()
            if isinstance(step, Reply):
                after_s += step.after_s
                self.say(step.message, after_s)
            else:
                self.beats = False


def _without_target(message: Message, expected: Message) -> Message:
    """Take the target out of a message where the script does not name one."""
    names = ("target_system", "target_component")
    return replace(message, **{n: 0 for n in names if getattr(expected, n, None) == 0})


@contextmanager
def vehicle_script(*steps: Step) -> Iterator[SimulatedLink]:
    """Give a link to a vehicle that follows the script, and see that all of it was spoken."""
    vehicle = ScriptedVehicle(steps)
    with SimulatedLink(vehicle, "script") as link:
        yield link
    assert not vehicle.left, f"not spoken: {list(vehicle.left)}"
