"""Besiege a service: thousands of connections of five kinds, while page, /healthz and Stop are asked.

    python scripts/campaigns/hostile_connections.py [--connections 2000] [--seconds 30] [--json FILE]

The service is a process of its own on this computer's loopback, the besiegers are another. What the service
closes is opened again. It ends by itself. Exit code 1 where an answer took more than 2 s or the service grew
by more than 30 MB.
"""

from __future__ import annotations

import asyncio
import json
import re
import resource
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any
from urllib.error import HTTPError

from campaign import ended, options, resident_mb

MOST_ANSWER_S, MOST_GROWN_MB = 2.0, 30.0
_GET = "GET {} HTTP/1.1\r\nhost: localhost\r\n\r\n"
_UPGRADE = (
    "GET /api/stream?rate_hz=20 HTTP/1.1\r\nhost: localhost\r\nupgrade: websocket\r\nconnection: upgrade\r\n"
    "sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
_UPLOAD = (
    "POST /api/check HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer no\r\ncontent-length: 60000\r\n\r\n"
)
_ALL = 4096
# What each kind says at once, what about once a second from then on, and how much it reads in one go.
KINDS: dict[str, tuple[str, str, int]] = {
    "idle": ("", "", _ALL),
    "slow sender": (_UPLOAD, "x", _ALL),
    "pipelined, never read": (_GET.format("/web/app.js") * 300, "", 0),
    "slow reader": (_GET.format("/openapi.json") * 100, "", 1),
    "half-open websocket": (_UPGRADE, "", _ALL),
}
_OPENED_A_SECOND = 2500.0
_CONNECT_S = 5.0
_LATE_S = 60.0  # the besiegers that have not ended by then hang


async def besiege(address: tuple[str, int], count: int, seconds: float) -> Counter[str]:
    """Hold so many connections open for so long; return how many of each kind were opened."""
    opened: Counter[str] = Counter()
    end_s = time.monotonic() + seconds
    kinds = list(KINDS)
    await asyncio.gather(
        *(_hold(kinds[k % len(kinds)], address, k / _OPENED_A_SECOND, end_s, opened) for k in range(count))
    )
    return opened


async def _hold(
    kind: str, address: tuple[str, int], after_s: float, end_s: float, opened: Counter[str]
) -> None:
    """Open a connection of a kind, and again as soon as it is cut off, until the end."""
    (at_once, piece, reads), loop = KINDS[kind], asyncio.get_running_loop()
    await asyncio.sleep(after_s)
    while time.monotonic() < end_s:
        with socket.socket() as client, suppress(OSError):  # a time limit that has passed is one
            client.setblocking(False)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ALL)
            opened[kind] += 1
            async with asyncio.timeout(_CONNECT_S):
                await loop.sock_connect(client, address)
            client.send(at_once.encode())
            cut_off = select.poll()  # who does not read is told it all the same
            cut_off.register(client, 0)
            while not cut_off.poll(0) and time.monotonic() < end_s:
                if reads < _ALL:
                    await asyncio.sleep(1.0)
                with suppress(TimeoutError):
                    async with asyncio.timeout(1.0):
                        if reads and not await loop.sock_recv(client, reads):
                            break
                client.send(piece.encode())
        await asyncio.sleep(0.02)


def campaign(connections: int, seconds: float) -> dict[str, Any]:
    """Serve, besiege and ask; return the figures."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        words = [sys.executable, "-m", "mavcompass", "serve", "sim:rover,seed=3", "--http", "127.0.0.1:0"]
        service = stack.enter_context(_process([*words, "--storage", folder]))
        assert service.stdout is not None
        page = next(
            found for line in service.stdout if (found := re.search(r"(http://\S+/)#token=(\S+)", line))
        )
        url, token = page[1], page[2]
        deadline = time.monotonic() + 60.0
        while not json.loads(_ask(f"{url}api/state")[1])["vehicle"] and time.monotonic() < deadline:
            time.sleep(0.1)
        for path in ("", "web/app.js", "healthz"):
            _ask(url + path)
        before_mb = resident_mb(service.pid)
        port = url.rstrip("/").rpartition(":")[2]
        words = [sys.executable, __file__, "--besiege", port, "--connections", str(connections)]
        crowd = stack.enter_context(_process([*words, "--seconds", str(seconds)]))
        slowest: dict[str, float] = {}
        asked: Counter[str] = Counter()
        failed: list[str] = []
        most_mb = before_mb
        deadline = time.monotonic() + seconds + _LATE_S
        while crowd.poll() is None and time.monotonic() < deadline:
            for name, path, body in (
                ("page", "", None),
                ("script", "web/app.js", None),
                ("health", "healthz", None),
                ("begin", "api/calibration", b'{"motion": "hand"}'),
                ("stop", "api/task/stop", b"{}"),
            ):
                began = time.monotonic()
                status, _ = _ask(url + path, body, token)
                slowest[name] = round(max(slowest.get(name, 0.0), time.monotonic() - began), 3)
                asked[name] += 1
                if status not in ((200,) if body is None else (200, 202, 409)):
                    failed.append(f"{name}: {status}")
            most_mb = max(most_mb, resident_mb(service.pid))
            time.sleep(0.05)
        opened = json.loads(crowd.communicate(timeout=1.0)[0])
        service.send_signal(signal.SIGTERM)
        ended = service.wait(60.0)
    return {
        "connections": connections,
        "seconds": seconds,
        "opened": opened,
        "asked": dict(asked),
        "slowest_s": slowest,
        "failed": failed[:10],
        "grown_mb": round(most_mb - before_mb, 1),
        "exit_code": ended,
    }


@contextmanager
def _process(words: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Start a program, which does not outlive the campaign, whatever breaks."""
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _ask(url: str, body: bytes | None = None, token: str = "") -> tuple[int | str, bytes]:
    headers = {"content-type": "application/json", "authorization": f"Bearer {token}"}
    try:
        request = urllib.request.Request(url, body, headers if body is not None else {})
        with urllib.request.urlopen(request, timeout=20.0) as answer:
            return answer.status, answer.read()
    except HTTPError as error:
        return error.code, error.read()
    except OSError as error:
        return f"{type(error).__name__}: {error}", b""


def main() -> int:
    """Run the campaign and judge it."""
    wanted = options(__doc__, connections=2000, seconds=30.0, besiege=(0, "a port: be the besiegers"))
    if wanted.besiege:
        most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
        print(
            json.dumps(
                asyncio.run(besiege(("127.0.0.1", wanted.besiege), wanted.connections, wanted.seconds))
            )
        )
        return 0
    figures = campaign(wanted.connections, wanted.seconds)
    print(json.dumps(figures, indent=1))
    bad = max(figures["slowest_s"].values()) > MOST_ANSWER_S or figures["grown_mb"] > MOST_GROWN_MB
    return ended(wanted.json, figures, bad or figures["failed"] or figures["exit_code"])


if __name__ == "__main__":
    sys.exit(main())
