"""SimulatedLink: a simulated vehicle inside this process, in virtual time and without sockets."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mavcompass.errors import LinkLost
from mavcompass.messages import Incoming, Message
from mavcompass.procedure.script import Show
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link
from mavcompass.vehicle.links.autopilot import Autopilot, Pace, Said

if TYPE_CHECKING:
    from mavcompass.simulation.vehicle import SimulatedAutopilot

# The vehicle is advanced in pieces of this length, which is therefore how long an answer takes at most.
STEP_S = 0.01
_GOLDEN = 0.6180339887
_MOVE_S = 3.0  # for the hands to lift or turn it
# A full turn on a side, slow enough for a compass that is read ten times a second.
_ROUND_S = 12.0


class SimulatedLink(Link):
    """Speak with a simulated vehicle. Its time passes only while `receive` waits.

    Attributes:
        autopilot: the vehicle, for looking at its truth and for playing the pilot in tests.
        person: follows a procedure's prompts and turns the vehicle by hand; None where nobody does.
    """

    person: SimulatedPerson | None = None

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
        self._heard: deque[tuple[Said, Message]] = deque()
        self._closed = False

    @classmethod
    def of(
        cls,
        vehicle: str,
        *,
        seed: int = 0,
        effects: Sequence[str] = (),
        identity: Identity = ONBOARD_COMPUTER,
        speed: float | None = None,
        by_hand: bool = False,
    ) -> SimulatedLink:
        """Make a vehicle and the link to it; `by_hand` it is disarmed, and a person is there to turn it.

        Raises UsageError for an unknown vehicle or effect.
        """
        autopilot = simulated_autopilot(vehicle, seed, effects, armed=not by_hand)
        link = cls(autopilot, f"sim:{vehicle},seed={seed}", identity, speed)
        link.person = SimulatedPerson(autopilot) if by_hand else None
        return link

    @property
    def waiting(self) -> bool:
        """Tell whether something was said that has not been handed out yet."""
        return bool(self._heard)

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
            if self._heard and self._heard[0][0].time_s <= deadline_s:
                said, message = self._heard.popleft()
                # A stream's message may carry a time just before a moment that was already waited for.
                self._now_s = max(self._now_s, said.time_s)
                self.statistics.received += 1
                return Incoming(self._now_s, said.system, said.component, message)
            # The simulation counts whole microseconds: it may never reach a deadline between two of them.
            if self._heard or self.autopilot.time_s >= deadline_s - 1e-6:
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
            if said.port in (None, self._port) and said.message is not None:
                self._heard.append((said, said.message))
        if self._pace is not None:
            self._pace.sleep_until(until_s)


class SimulatedPerson:
    """Turn a simulated vehicle by hand as a procedure's prompts say, so that this can be tried."""

    def __init__(self, autopilot: SimulatedAutopilot) -> None:
        self._autopilot = autopilot
        self._busy_until_s = autopilot.time_s
        self._roll_rad = self._pitch_rad = 0.0
        self._sides = 0

    def __call__(self, show: Show) -> None:
        """Read a prompt, and do what it says unless the hands are still at the one before."""
        from mavcompass.simulation.physics.hand import HandMove

        if self._autopilot.time_s < self._busy_until_s:
            return
        told = {name: math.radians(value) for name, value in show.data}
        move = None
        if (turn_rad := told.get("left_deg", told.get("round_deg"))) is not None:
            lasts_s = _MOVE_S if "left_deg" in told else _ROUND_S
            move = HandMove(turn_rad, lasts_s, 0.0, self._roll_rad, self._pitch_rad)
        elif "roll_deg" in told or "level" in told:
            move = HandMove(0.0, _MOVE_S, 0.0, told.get("roll_deg", 0.0), told.get("pitch_deg", 0.0))
        elif "tumble" in told:
            # No two sides alike, and the better part of a turn on each.
            self._sides += 1
            roll_rad = math.remainder(self._sides * 2.0 * math.pi * _GOLDEN, 2.0 * math.pi)
            pitch_rad = math.asin(2.0 * (self._sides * math.sqrt(2.0) % 1.0) - 1.0)
            move = HandMove(math.radians(200.0), 4.0, 0.0, roll_rad, pitch_rad)
        held = (self._roll_rad, self._pitch_rad)
        if move is not None and (move.turn_rad or (move.roll_rad, move.pitch_rad) != held):
            self._autopilot.turn_by_hand([move])
            self._roll_rad, self._pitch_rad = move.roll_rad, move.pitch_rad
            self._busy_until_s = self._autopilot.time_s + move.lasts_s


def simulated_autopilot(
    vehicle: str, seed: int = 0, effects: Sequence[str] = (), armed: bool = True
) -> SimulatedAutopilot:
    """Make a simulated vehicle; effects are spelled as in `mavcompass gap catalogue`: NAME[:param=value,..].

    Raises UsageError for an unknown vehicle or effect.
    """
    from mavcompass.simulation.vehicle import SimulatedAutopilot

    return SimulatedAutopilot(vehicle, seed=seed, armed=armed, effects=effects)
