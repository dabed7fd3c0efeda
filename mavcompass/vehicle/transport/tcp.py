"""TCP: a client that connects to a vehicle, and a server that waits for connections."""

from __future__ import annotations

import os
import selectors
import socket
from contextlib import suppress

from mavcompass.errors import LinkLost, UsageError
from mavcompass.vehicle.transport.stream import Stream, StreamTransport
from mavcompass.vehicle.transport.transport import Peer, Reconnect

# Long enough for a radio modem, short enough that Ctrl-C is not ignored.
_CONNECT_S = 2.0


def _at_once(connected: socket.socket) -> socket.socket:
    """Have a connection send what it is given, instead of waiting for more."""
    connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connected


def connect_tcp(host: str, port: int, reconnect: Reconnect) -> StreamTransport:
    """Connect to a vehicle or a router. Raises NoVehicle when nobody listens there."""
    return StreamTransport(
        f"tcp:{host}:{port}",
        lambda: _at_once(socket.create_connection((host, port), timeout=_CONNECT_S)),
        reconnect,
        "Check that the vehicle or simulator is running and that host and port are right.",
    )


class TcpServerTransport:
    """Wait for connections; each is a peer, and comes and goes as it likes."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcpin:{host}:{port}"
        self._streams: dict[Peer, Stream] = {}
        self._accepted = 0
        self._closed = False
        self._selector = selectors.DefaultSelector()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._listener = socket.create_server((host, port), family=family)
        except OSError as error:
            self._selector.close()
            raise UsageError(
                f"{self.name} cannot be listened on: {os.strerror(error.errno) if error.errno else error}.",
                "Choose an address of this machine and a port that no other program uses.",
            ) from error
        self.name = f"tcpin:{host}:{self.port}"
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def port(self) -> int:
        """Return the port, also where 0 was asked for."""
        return int(self._listener.getsockname()[1])

    def wait(self, timeout_s: float) -> None:
        """Return when something may have come, or after the time."""
        for stream in self._streams.values():
            writing = selectors.EVENT_WRITE if stream.has_waiting else 0
            self._selector.modify(stream.fileno(), selectors.EVENT_READ | writing)
        self._selector.select(max(timeout_s, 0.0))

    def read(self) -> list[tuple[Peer, bytes]]:
        """Take new connections and return what has come on all."""
        if self._closed:
            raise LinkLost(f"{self.name} is closed.")
        self._accept()
        pieces: list[tuple[Peer, bytes]] = []
        for peer, stream in list(self._streams.items()):
            try:
                if data := stream.read():
                    pieces.append((peer, data))
            except (OSError, EOFError):
                self.disconnect(peer)
        return pieces

    def write(self, data: bytes, peer: Peer) -> bool:
        """Send to one connection."""
        if peer not in self._streams:
            return False
        try:
            return self._streams[peer].write(data)
        except OSError:
            self.disconnect(peer)
            return False

    def peers(self) -> list[Peer]:
        """List the connections."""
        return list(self._streams)

    def hang_up(self) -> None:
        """Close all connections but keep listening."""
        for peer in self.peers():
            self.disconnect(peer)

    def disconnect(self, peer: Peer) -> None:
        """Close one connection."""
        stream = self._streams.pop(peer)
        self._selector.unregister(stream.fileno())
        stream.close()

    def close(self) -> None:
        """Close all connections and the port."""
        if not self._closed:
            self._closed = True
            self.hang_up()
            self._selector.close()
            self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # nobody is waiting, or gave up in the meantime
            while True:
                connection, _ = self._listener.accept()
                stream = Stream(_at_once(connection))
                self._accepted += 1
                self._streams[self._accepted] = stream
                self._selector.register(stream.fileno(), selectors.EVENT_READ)
