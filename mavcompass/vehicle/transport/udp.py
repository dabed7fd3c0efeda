"""UDP: a port that waits for vehicles to speak, and one that speaks first."""

from __future__ import annotations

import select
import socket
import time
from typing import Any, cast

from mavcompass.errors import LinkLost, UsageError
from mavcompass.vehicle.transport.transport import READ_BYTES, Peer

# A peer that has not spoken for so long is no longer sent to; it is learnt again when it speaks.
_FORGET_PEER_S = 60.0
# Anybody may send from any number of addresses; a vehicle and its stations are a handful.
_MOST_PEERS = 1024
# What comes while a calibration is solved waits in the kernel, for seconds on a small computer. PX4 was seen
# to send 800 datagrams a second, each of which counts there as a kilobyte. The kernel may allow less.
_BUFFER_BYTES = 4 << 20


class UdpTransport:
    """Carry datagrams. Peers are remote addresses: learnt from what they send, or given at the start."""

    def __init__(self, name: str, bound: socket.socket, first_peer: Peer | None = None) -> None:
        bound.setblocking(False)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        self.name = name
        self._socket = bound
        self._first_peer = first_peer
        self._last_heard_s: dict[Peer, float] = {}
        self._closed = False

    @classmethod
    def listening(cls, host: str, port: int) -> UdpTransport:
        """Wait on a local port for whoever speaks first. Raises UsageError when it is taken."""
        name = f"udpin:{host}:{port}"
        local = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            local.bind((host, port))
        except OSError as error:
            local.close()
            raise UsageError(
                f"{name} cannot be listened on: {error.strerror or error}.",
                "Close the other program that uses this port, or choose another address.",
            ) from error
        return cls(f"udpin:{host}:{local.getsockname()[1]}", local)

    @classmethod
    def speaking_to(cls, host: str, port: int) -> UdpTransport:
        """Speak first to a remote port, answers come back to ours. Raises UsageError for an unknown host."""
        name = f"udpout:{host}:{port}"
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise UsageError(
                f"The host of {name} is not known: {error.strerror or error}.", "Check the host name."
            ) from error
        return cls(name, socket.socket(family, socket.SOCK_DGRAM), address)

    @property
    def port(self) -> int:
        """Return the local port, also where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    def wait(self, timeout_s: float) -> None:
        """Return when something may have come, or after the time."""
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        poll.poll(max(timeout_s, 0.0) * 1000.0)

    def read(self) -> list[tuple[Peer, bytes]]:
        """Return the datagrams that have come."""
        if self._closed:
            raise LinkLost(f"{self.name} is closed.")
        pieces: list[tuple[Peer, bytes]] = []
        read_bytes = 0
        while read_bytes < READ_BYTES and len(pieces) < 256:  # a flood must not keep us from sending
            try:
                data, peer = self._socket.recvfrom(READ_BYTES)
            except OSError:
                break  # nothing more, or an earlier datagram was refused: nobody listens there yet
            if peer not in self._last_heard_s and len(self._last_heard_s) >= _MOST_PEERS:
                del self._last_heard_s[min(self._last_heard_s, key=self._last_heard_s.__getitem__)]
            self._last_heard_s[peer] = time.monotonic()
            pieces.append((peer, data))
            read_bytes += len(data)
        return pieces

    def write(self, data: bytes, peer: Peer) -> bool:
        """Send a datagram."""
        try:
            self._socket.sendto(data, cast(tuple[Any, ...], peer))
        except OSError:
            return False
        return True

    def peers(self) -> list[Peer]:
        """List the addresses to send to: those heard lately, and the one given at the start."""
        oldest = time.monotonic() - _FORGET_PEER_S
        heard = [peer for peer, last_s in self._last_heard_s.items() if last_s > oldest]
        if self._first_peer is not None and self._first_peer not in heard:
            heard.append(self._first_peer)
        return heard

    def hang_up(self) -> None:
        """Do nothing: UDP has no connections."""

    def close(self) -> None:
        """Close the port."""
        self._closed = True
        self._socket.close()
