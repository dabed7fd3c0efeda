"""MAVSDK (mavsdk >= 4) as a carrier of bytes, for stacks that already are MAVSDK.

MAVSDK opens the vehicle's port and keeps its connection; it forwards every frame, as it is, to a second
connection without a port, whose bytes are handed to us, and what we hand to that one goes to the vehicle.
Its `mavlink_direct`, which speaks of messages as JSON, would lose the bits of every number that is not
finite: PX4's whole-number parameters travel in the place of a float, where -1 is such a number.
"""

from __future__ import annotations

import logging
import queue
from functools import cache
from typing import Any

from mavcompass.errors import LinkLost, NoVehicle
from mavcompass.vehicle.transport.transport import Peer

_log = logging.getLogger(__name__)

# MAVSDK's queues know no limit; a program that does not listen must not fill the memory.
_MOST_WAITING = 20_000
# Who MAVSDK itself is: the last of the onboard computers, so that nothing is said to it that is for us.
_OWN_ADDRESS = (1, 194)
_V2, _V2_SENDER = 0xFD, slice(5, 7)


class MavsdkTransport:
    """Carry bytes through MAVSDK. `url` is in its spelling, such as udpin://0.0.0.0:14550."""

    def __init__(self, url: str) -> None:
        """Open the port. Raises NoVehicle where MAVSDK cannot."""
        from mavsdk.connection_result import ConnectionResult
        from mavsdk.enums import ForwardingOption
        from mavsdk.mavsdk import Configuration, Mavsdk

        _log_through_python()
        self.name = f"mavsdk+{url}"
        self._inbox: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._waiting: list[bytes] = []
        # Always with heartbeats: a router answers only to those it has heard.
        self._mavsdk: Any = Mavsdk(Configuration.create_manual(*_OWN_ADDRESS, True))
        for address in ("raw://", url):
            result = self._mavsdk.add_any_connection_with_forwarding(address, ForwardingOption.ON)
            if result != ConnectionResult.SUCCESS:
                self.close()
                reason = ConnectionResult(result).name.lower().replace("_", " ")
                raise NoVehicle(
                    f"MAVSDK could not open {url}: {reason}.",
                    "Check the address, and that no other program uses this port.",
                )
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._take)

    def wait(self, timeout_s: float) -> None:
        """Return when something may have come, or after the time."""
        if self._waiting:
            return
        try:
            self._waiting.append(self._inbox.get(timeout=max(timeout_s, 0.0)))
        except queue.Empty:
            return

    def read(self) -> list[tuple[Peer, bytes]]:
        """Return the frames that have come. Raises LinkLost once it is closed."""
        if self._mavsdk is None:
            raise LinkLost(f"{self.name} is closed.")
        frames, self._waiting = self._waiting, []
        while not self._inbox.empty():
            frames.append(self._inbox.get())
        return [(self.name, frame) for frame in frames]

    def write(self, data: bytes, peer: Peer) -> bool:
        """Hand a frame to MAVSDK, which sends it on all its connections."""
        if self._mavsdk is None:
            return False
        self._mavsdk.pass_received_raw_bytes(data)
        return True

    def peers(self) -> list[Peer]:
        """List the one there is: MAVSDK does not tell who is behind it."""
        return [] if self._mavsdk is None else [self.name]

    def hang_up(self) -> None:
        """Do nothing: MAVSDK reconnects by itself."""

    def close(self) -> None:
        """Leave MAVSDK and let go of its port."""
        if self._mavsdk is not None:
            self._mavsdk.destroy()
            self._mavsdk = None

    def _take(self, frame: bytes) -> None:
        """Take a frame, in MAVSDK's thread, which only prints what goes wrong; its own are not for us."""
        own = frame[0] == _V2 and tuple(frame[_V2_SENDER]) == _OWN_ADDRESS
        if not own and self._inbox.qsize() < _MOST_WAITING:
            self._inbox.put(frame)


@cache
def _log_through_python() -> None:
    """Keep MAVSDK's log off the standard output, which may be carrying JSON."""
    from mavsdk.logging import log_subscribe

    def log(level: Any, text: str, file: str | None, line: int) -> bool:
        _log.debug("MAVSDK: %s", text)
        return True

    log_subscribe(log)
