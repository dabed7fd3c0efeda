"""Connections that dawdle are closed: who opens many and says little does not shut the page for others."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 256
# A request's head and body have so long, twice over at the most.
PATIENCE_S = 10.0


class Connection(H11Protocol):
    """Be one connection of a browser or program; the oldest that only waits makes room for a new one."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, and keep an eye on it."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._looked_at: object = self
        self._look: asyncio.TimerHandle | None = None
        # What is aborted is still among the connections until the loop comes round.
        open_now = [c for c in self.connections if not c.transport.is_closing()]
        if len(open_now) > MOST_CONNECTIONS:
            waiting = [c for c in open_now if isinstance(c, Connection) and c._is_waiting()]
            if waiting:
                min(waiting, key=lambda c: c._since_s).transport.abort()
        self._look = self.loop.call_later(PATIENCE_S, self._look_after)

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of it."""
        if self._look is not None:
            self._look.cancel()
        super().connection_lost(exc)

    def _is_waiting(self) -> bool:
        """Tell whether the other side has yet to say something: a head, a body, the next request."""
        return self.cycle is None or self.cycle.response_complete or self.cycle.more_body

    def _look_after(self) -> None:
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            return  # gone, or a WebSocket by now
        # Before the first request there is no second look: nobody needs so long to begin.
        dawdles = self._is_waiting() and self._looked_at is (self.cycle or self)
        if dawdles:
            self.transport.abort()
            return
        self._looked_at = self.cycle or self
        self._look = self.loop.call_later(PATIENCE_S, self._look_after)
