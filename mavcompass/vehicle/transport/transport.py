"""Transport: bytes to and from peers, over any kind of port. It knows nothing of MAVLink.

Everything is non-blocking; `wait` is the only place that waits. A peer is one other end: a connection of
a TCP server, a remote address of a UDP port, or the only one there is.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol

Peer = Hashable

# Enough for a second of a fast link; what a peer does not take in that time is dropped.
SEND_BUFFER_BYTES = 262_144
READ_BYTES = 65_536


class Transport(Protocol):
    """Carry bytes."""

    name: str

    def wait(self, timeout_s: float) -> None:
        """Return when something may have come, or after the time."""

    def read(self) -> list[tuple[Peer, bytes]]:
        """Return what has come, without waiting. Raises LinkLost when nothing will ever come again."""

    def write(self, data: bytes, peer: Peer) -> bool:
        """Send to one peer, without waiting; False when it could not be taken."""

    def peers(self) -> list[Peer]:
        """List the peers that can be written to now."""

    def hang_up(self) -> None:
        """Drop all connections, as a rebooting vehicle does; they may come again."""

    def close(self) -> None:
        """Let go of the port; calling it again does nothing."""


@dataclass(frozen=True, slots=True)
class Reconnect:
    """Say how patient to be with a connection that is refused or breaks.

    Attributes:
        first_s: keep trying so long for the first connection. again_s: so long after it broke (a reboot of
            the vehicle breaks TCP and USB connections). every_s: time between tries.
    """

    first_s: float = 3.0
    again_s: float = 15.0
    every_s: float = 0.25
