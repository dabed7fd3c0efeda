"""A simulated vehicle at the far end of a wire, in virtual time: its bytes instead of its messages."""

from __future__ import annotations

from abc import abstractmethod

from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.transport import Peer, Transport


class VehicleOnWire(Transport):
    """Be the bytes of a vehicle; what a message becomes, and what is understood, is for those made of it."""

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self.vehicle = vehicle
        self._said = bytearray()

    @abstractmethod
    def packed(self, said: Outgoing) -> bytes:
        """Return the bytes of a message, none where it cannot be said."""

    def wait(self, timeout_s: float) -> None:
        """Let the vehicle live on for a moment."""
        for said in self.vehicle.advance(self.vehicle.time_s + min(max(timeout_s, 1e-5), 0.01)):
            if said.port in (None, 0) and said.message is not None:
                self._said += self.packed(said)

    def read(self) -> list[tuple[Peer, bytes]]:
        """Return what the vehicle said."""
        data, self._said = bytes(self._said), bytearray()
        return [("vehicle", data)] if data else []

    def peers(self) -> list[Peer]:
        """Name the one vehicle."""
        return ["vehicle"]
