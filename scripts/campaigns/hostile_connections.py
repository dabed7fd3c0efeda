"""Besiege a service: thousands of connections of five kinds, while page, /healthz and Stop are asked.

    python scripts/campaigns/hostile_connections.py [--connections 2000] [--seconds 30] [--json FILE]

The service is a process of its own on this computer's loopback, the besiegers are another. What the service
closes is opened again. It ends by itself. Exit code 1 where an answer took more than 2 s or the service grew
by more than 30 MB.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter, deque
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError

MOST_ANSWER_S, MOST_GROWN_MB = 2.0, 30.0
_GET = "GET {} HTTP/1.1\r\nhost: localhost\r\n\r\n"
_UPGRADE = (
    "GET /api/stream?rate_hz=20 HTTP/1.1\r\nhost: localhost\r\nupgrade: websocket\r\nconnection: upgrade\r\n"
    "sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
_UPLOAD = (
    "POST /api/check HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer no\r\ncontent-length: 60000\r\n\r\n"
)
# What each kind says at once, and the piece that it says or reads about once a second from then on.
KINDS: dict[str, tuple[str, str]] = {
    "idle": ("", ""),
    "slow sender": (_UPLOAD, "x"),
    "pipelined, never read": (_GET.format("/web/app.js") * 300, ""),
    "slow reader": (_GET.format("/openapi.json") * 100, "read"),
    "half-open websocket": (_UPGRADE, ""),
}
_OPENED_AGAIN_A_TURN = 50
_PIECE = 1 << 10  # it is time for the next piece


def besiege(address: tuple[str, int], count: int, seconds: float) -> Counter[str]:
    """Hold so many connections open for so long; return how many of each kind were opened."""
    opened: Counter[str] = Counter()
    missing = deque(kind for number in range(count) for kind in [list(KINDS)[number % len(KINDS)]])
    ends = time.monotonic() + seconds
    next_second = 0.0
    with selectors.DefaultSelector() as gone:
        while (now := time.monotonic()) < ends:
            for _ in range(min(len(missing), _OPENED_AGAIN_A_TURN)):
                kind = missing.popleft()
                client = socket.socket()
                client.setblocking(False)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                client.connect_ex(address)
                gone.register(client, selectors.EVENT_WRITE, kind)
                opened[kind] += 1
            turn = gone.select(0.02)
            if now > next_second:
                next_second = now + 1.0
                turn += [(key, _PIECE) for key in gone.get_map().values()]
            for key, event in turn:
                if key.fd in gone.get_map() and _is_over(gone, key, event):
                    gone.unregister(key.fileobj)
                    key.fileobj.close()  # type: ignore[union-attr]
                    missing.append(key.data)
    return opened


def _is_over(gone: selectors.BaseSelector, key: selectors.SelectorKey, event: int) -> bool:
    """Say or read what is next on one connection; tell whether it was cut off."""
    client, (at_once, piece) = key.fileobj, KINDS[key.data]
    assert isinstance(client, socket.socket)
    try:
        if event & selectors.EVENT_WRITE:
            client.send(at_once.encode())
            # Who does not read is told that it was cut off all the same.
            gone.modify(client, 0 if "read" in key.data else selectors.EVENT_READ, key.data)
        elif event == _PIECE:
            if piece == "read":
                return not client.recv(1)
            client.send(piece.encode())
        else:
            return not event or not client.recv(4096)
    except BlockingIOError:
        pass
    except OSError:
        return True
    return False


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
        before_mb = _memory_mb(service.pid)
        port = url.rstrip("/").rpartition(":")[2]
        words = [sys.executable, __file__, "--besiege", port, "--connections", str(connections)]
        crowd = stack.enter_context(_process([*words, "--seconds", str(seconds)]))
        slowest: dict[str, float] = {}
        asked: Counter[str] = Counter()
        failed: list[str] = []
        most_mb = before_mb
        while crowd.poll() is None:
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
            most_mb = max(most_mb, _memory_mb(service.pid))
            time.sleep(0.05)
        assert crowd.stdout is not None
        opened = json.loads(crowd.stdout.read())
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


def _process(words: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


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


def _memory_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    """Run the campaign and judge it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--connections", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--besiege", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.besiege:
        most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
        print(json.dumps(besiege(("127.0.0.1", options.besiege), options.connections, options.seconds)))
        return 0
    figures = campaign(options.connections, options.seconds)
    print(json.dumps(figures, indent=1))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    too_slow = max(figures["slowest_s"].values()) > MOST_ANSWER_S
    return int(
        bool(too_slow or figures["failed"] or figures["exit_code"] or figures["grown_mb"] > MOST_GROWN_MB)
    )


if __name__ == "__main__":
    sys.exit(main())
