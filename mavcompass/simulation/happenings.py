"""What happens to a vehicle from outside: hooks for tests and demonstrations."""

from __future__ import annotations

from collections.abc import Iterable

from mavcompass.simulation.autopilot import Firmware
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.physics.motion import Body


class Happenings:
    """Let pilots, hands, batteries and broken parts act on a simulated vehicle."""

    firmware: Firmware
    body: Body

    def disarm(self) -> None:
        """Let the pilot disarm."""
        self.firmware.arming.disarm()

    def pilot_switches_mode(self, mode: str) -> None:
        """Let the pilot move the mode switch."""
        self.firmware.modes.enter(mode)

    def pilot_moves_stick(self, channel: int = 1, pwm: int = 1800, for_s: float = 3.0) -> None:
        """Let the pilot hold a stick (RC channel) away from its centre for a while."""
        self.firmware.pilot_moves_stick(channel, pwm, for_s)

    def turn_by_hand(self, moves: Iterable[HandMove]) -> None:
        """Let a person turn the vehicle, from now on or after the moves already planned."""
        self.body.hand.add(moves, self.body.time_s)

    def jam(self) -> None:
        """Block what turns the vehicle: wheels in the mud, a rope in the propeller."""
        self.body.jammed = True

    def battery_failsafe(self) -> None:
        """Let the battery run low."""
        self.firmware.battery_failsafe()

    def cut_sensor(self, instance: int = 1) -> None:
        """Unplug a compass: its last value keeps streaming, its health falls."""
        self.firmware.compasses.lose(instance, healthy=False, value=None)

    def zero_compass(self, instance: int = 1) -> None:
        """Let a compass deliver zeros: what is left are its offsets."""
        self.firmware.compasses.lose(instance, healthy=True, value=(0.0, 0.0, 0.0))
