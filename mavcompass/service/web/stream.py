"""The WebSocket: headings and progress, at most so many times a second.

Each listener looks at what the station knows when it is its turn. Nothing is queued, so a slow listener
costs nothing and sees the newest all the same.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from mavcompass.service.station import Station
from mavcompass.service.web.state import finding_json, moment_json

DEFAULT_HZ, MOST_HZ = 10.0, 20.0
# What listeners say is dropped; none needs more for it.
MOST_HEARD_BYTES = 4096


class Stream:
    """Serve listeners."""

    def __init__(self, station: Station) -> None:
        self._station = station

    async def endpoint(self, socket: WebSocket) -> None:
        """Send `now` and what a run's trail has grown by at the listener's rate, the rest as it changes."""
        rate_hz = _rate(socket.query_params.get("rate_hz"))
        with contextlib.suppress(WebSocketDisconnect):
            await socket.accept()
            goodbye = asyncio.ensure_future(_until_gone(socket))
            try:
                await self._send(socket, 1.0 / rate_hz, goodbye)
            finally:
                goodbye.cancel()

    async def _send(self, socket: WebSocket, period_s: float, goodbye: asyncio.Future[None]) -> None:
        seen: dict[str, Any] = {}
        drawn: dict[int, dict[int, int]] = {}  # by task and compass: the points that were sent
        while not goodbye.done():
            message: dict[str, Any] = {"now": moment_json(self._station)}
            task = self._station.desk.current
            news = {
                "task": None if task is None else task.to_json(),
                "findings": [finding_json(finding) for finding in self._station.findings],
            }
            message |= {key: value for key, value in news.items() if seen.get(key, ...) != value}
            seen = news
            if task is not None and task.trail.points:
                known = drawn.setdefault(task.number, {})
                message["trail"] = {"task": task.number, **task.trail.since(known)}
                for instance, trail in message["trail"]["compasses"].items():
                    known[instance] = trail["first"] + len(trail["points"])
            await socket.send_text(json.dumps(message))
            await asyncio.wait([goodbye], timeout=period_s)


async def _until_gone(socket: WebSocket) -> None:
    """Read and drop what a listener says until it leaves."""
    try:
        while True:
            await socket.receive_text()
    except (WebSocketDisconnect, KeyError, RuntimeError):
        return


def _rate(text: str | None) -> float:
    try:
        rate_hz = float(text or DEFAULT_HZ)
    except ValueError:
        return DEFAULT_HZ
    return min(max(rate_hz, 0.1), MOST_HZ) if rate_hz == rate_hz else DEFAULT_HZ
