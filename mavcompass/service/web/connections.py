"""Connections are bounded in number, time and bytes: who opens many and says or reads little shuts none out.

A connection costs while it waits for its other side: to say something (a head, a body, the next request), to
take what was sent, to be closed. It may wait for so long at a time. Where too many are open, the one that has
waited longest makes room; a newcomer has waited for nothing yet.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

MOST_CONNECTIONS = 256
# No browser asks in a pipeline.
_PIPELINED_AFTER_S = 0.25
MOST_LISTENERS, MOST_LISTENERS_OF_ONE = 16, 12
_NO_PLACE = b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"
# For a request's head and its body each, and for the other side to take 16 kB: a radio modem is faster.
PATIENCE_S = 10.0
# What one connection may hold in each direction, here and with the system; a piece of a file comes on top.
MOST_HELD_BYTES = 16_384
# Newcomers wait with the system until it is their turn; few are accepted at a time, so that each is heard
# before many others have come.
ACCEPTED_AT_A_TIME, MOST_QUEUED = 32, 4096


def listen_bounded(listener: socket.socket) -> None:
    """Let the connections of a socket inherit small buffers."""
    for direction in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        listener.setsockopt(socket.SOL_SOCKET, direction, MOST_HELD_BYTES)


class OpenConnections(set[Any]):
    """Hold the connections of a server; `line`: in the order in which they began to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.line: dict[_Bounded, None] = {}


class _Bounded(asyncio.Protocol):
    """Watch over one connection; mixed in before the protocol that uvicorn has for it."""

    transport: asyncio.Transport
    loop: asyncio.AbstractEventLoop
    connections: Any  # OpenConnections

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, and let another go where there are too many."""
        super().connection_made(transport)
        self._waits_since()
        transport.set_write_buffer_limits(high=MOST_HELD_BYTES)
        self._look = self.loop.call_later(PATIENCE_S, self._look_after)
        if len(self.connections.line) > MOST_CONNECTIONS:
            first = next((one for one in self.connections.line if one._waits()), None)
            if first is not None:
                first._drop()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of it."""
        self._leave()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Wait for the other side to take what was sent."""
        self._waits_since()
        super().pause_writing()

    def _waits_since(self) -> None:
        self._since_s = self.loop.time()
        self.connections.line.pop(self, None)
        self.connections.line[self] = None

    def _leave(self) -> None:
        self._look.cancel()
        self.connections.line.pop(self, None)

    def _is_waiting(self) -> bool:
        """Tell whether the other side has yet to say or to take something."""
        raise NotImplementedError

    def _waits(self) -> bool:
        return self.transport.is_closing() or self._is_waiting()

    def _drop(self) -> None:
        """Cut it off; what it was sent and did not take is forgotten at once, by the system too."""
        self._leave()
        at_once = struct.pack("ii", 1, 0)
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
        self.transport.abort()

    def _look_after(self) -> None:
        left_s = PATIENCE_S
        if self._waits():
            left_s += self._since_s - self.loop.time()
            if left_s <= 0.0:
                self._drop()
                return
        self._look = self.loop.call_later(left_s, self._look_after)


class Connection(_Bounded, H11Protocol):
    """Be one connection of a browser or program."""

    def data_received(self, data: bytes) -> None:
        """Hear a piece; a head that is whole gives its body time of its own."""
        before = self.cycle
        super().data_received(data)
        if self.cycle is not before:
            self._waits_since()

    def on_response_complete(self) -> None:
        """Wait for the next request; one that is here before the answer to the last, others go before."""
        self._waits_since()
        if self.flow.read_paused:
            self.loop.call_later(_PIPELINED_AFTER_S, super().on_response_complete)
        else:
            super().on_response_complete()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Turn into a listener where there is a place, and what was sent before is taken."""
        hosts = [one.client and one.client[0] for one in self.connections if isinstance(one, Listener)]
        mine = self.client and self.client[0]
        if len(hosts) >= MOST_LISTENERS or hosts.count(mine) >= MOST_LISTENERS_OF_ONE:
            self.transport.write(_NO_PLACE)
            self.transport.close()
        elif self.transport.get_write_buffer_size():
            self._drop()
        else:
            self._leave()
            super().handle_websocket_upgrade(event)

    def _is_waiting(self) -> bool:
        if self.cycle is None or self.cycle.response_complete or self.cycle.more_body:
            return True
        return self.flow.write_paused


class Listener(_Bounded, WebSocketsSansIOProtocol):  # type: ignore[misc]  # they name a transport differently
    """Be one WebSocket; pings tell a listener that only listens from one that is gone."""

    def _is_waiting(self) -> bool:
        return not self.writable.is_set()
