"""What the simulated flight controller asks of the firmware that runs on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from mavcompass.correction import FieldCorrection, Vector
from mavcompass.messages import Heartbeat, Message
from mavcompass.simulation.physics.motion import Drive


@dataclass(frozen=True, slots=True)
class Sender:
    """Name the station that sent a message, and the port it came in by."""

    system: int
    component: int
    port: int


class Firmware(Protocol):
    """Behave as one autopilot's software."""

    armed: bool
    available: frozenset[int]

    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins in the middle of a mission instead."""

    def handle(self, message: Message, sender: Sender) -> None:
        """Act on a message; one that means nothing here is ignored."""

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""

    def attend(self) -> None:
        """Do what is due at a tick: time-outs, periodic texts, parameter lists."""

    def use_compasses(self, dt_s: float) -> None:
        """Take the new compass readings into the attitude."""

    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force of compass 1, 2 or 3."""

    def heartbeat(self) -> Heartbeat:
        """Describe the vehicle."""

    def report(self, kind: type[Message], time_us: int, share: float) -> Message | None:
        """Build a telemetry message; `share` is how far the time lies between the last two ticks."""

    def default_intervals(self) -> Mapping[int, int]:
        """Return message id -> interval in microseconds of what a port sends unasked."""

    def pilot_disarms(self) -> None:
        """Disarm by the pilot's hand."""

    def pilot_switches_mode(self, mode: str) -> None:
        """Change mode by the pilot's hand."""

    def pilot_moves_stick(self, channel: int, pwm: int, for_s: float) -> None:
        """Hold a stick."""

    def battery_failsafe(self) -> None:
        """React to an empty battery."""

    def lose_compass(self, instance: int, healthy: bool, value: Vector | None) -> None:
        """Stop a compass, at a raw value or at its last reading."""
