"""Put the service together, run it until it is told to stop, and stop it gracefully; tell systemd of it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import signal
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import uvicorn

from mavcompass.errors import UsageError
from mavcompass.service.addresses import page_urls
from mavcompass.service.config import ServiceConfig, split_host_port
from mavcompass.service.station import OpenLink, Station
from mavcompass.service.web.app import build_app
from mavcompass.service.web.connections import (
    ACCEPTED_AT_A_TIME,
    MOST_QUEUED,
    PATIENCE_S,
    Connection,
    Listener,
    OpenConnections,
    listen_bounded,
)
from mavcompass.service.web.security import load_token
from mavcompass.service.web.state import MOST_HEARD_BYTES
from mavcompass.service.work.history import History
from mavcompass.service.work.jobs import Gaps
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.transport import Reconnect, Simulated, parse_address
from mavcompass.vehicle.wire import Signing

_log = logging.getLogger(__name__)

# A station whose loop has not turned for so long is stuck: a procedure cleans up in less.
STUCK_S = 25.0
_BEAT_EVERY_S = 1.0
_FOLDERS = ("recordings", "reports", "undo")


class _Server(uvicorn.Server):
    """Be a server that leaves the signals to the service, and bounds its connections."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.server_state.connections = OpenConnections()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(MOST_QUEUED)


class Service:
    """Be the whole service in one process.

    Attributes:
        address: host and port of the page, known once it listens. token: the secret.
    """

    def __init__(self, config: ServiceConfig, open_link: OpenLink | None = None) -> None:
        """Open files and port. Raises UsageError or MavCompassError where that cannot be done."""
        self.config = config
        _keep_private(config.folder)
        self.token = load_token(config.token_file)
        self._socket = _listen(config.http.listen)
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self.history = History(config.folder / "history.db")
        self.station = Station(config, self.history, open_link or link_opener(config))
        self.gaps = Gaps(config, self.history)
        self._notifier = Notifier()
        self._beaten_s: dict[int, float] = {}  # the station's latest beat, since when
        self._stopping: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def url(self) -> str:
        """Return the page's address, the first where there are several."""
        return next(iter(page_urls(*self.address)))

    def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until SIGTERM, SIGINT or `stop`."""
        asyncio.run(self._serve(on_ready))

    def stop(self) -> None:
        """Ask it to end; any thread may, and more than once."""
        if self._loop is not None and self._stopping is not None:
            with contextlib.suppress(RuntimeError):  # it has ended already
                self._loop.call_soon_threadsafe(self._stopping.set)

    async def _serve(self, on_ready: Callable[[], None]) -> None:
        self._loop, self._stopping = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            with contextlib.suppress(ValueError, RuntimeError):  # not the main thread: a test
                self._loop.add_signal_handler(number, self._stopping.set)
        app = build_app(
            self.config, self.station, self.history, self.gaps, self.token, lambda: not self._is_stuck()
        )
        server = _Server(
            uvicorn.Config(
                app,
                http=Connection,
                ws=Listener,
                ws_max_size=MOST_HEARD_BYTES,
                ws_ping_interval=PATIENCE_S,
                ws_ping_timeout=PATIENCE_S,
                backlog=ACCEPTED_AT_A_TIME,
                lifespan="off",
                log_config=None,
                access_log=False,
                timeout_graceful_shutdown=2,
            )
        )
        self.station.start()
        serving = asyncio.create_task(server.serve(sockets=[self._socket]))
        watching = asyncio.create_task(self._watch())
        self._notifier.ready(f"serving {self.config.vehicle.source} on {self.url}")
        on_ready()
        await asyncio.wait(
            [serving, asyncio.create_task(self._stopping.wait())], return_when="FIRST_COMPLETED"
        )
        self._notifier.stopping()
        _log.info("stopping")
        watching.cancel()
        # A procedure ends safely first; the page sees it end.
        if not await asyncio.to_thread(self.station.stop):
            _log.error("the station did not stop in time")
        self.gaps.stop()
        server.should_exit = True
        await serving
        self.history.close()

    async def _watch(self) -> None:
        """Tell the service manager that all is well, as long as it is."""
        every_s = min(_BEAT_EVERY_S, self._notifier.watchdog_s / 3.0)
        status = ""
        while True:
            if not self._is_stuck():
                self._notifier.alive()
            now = "vehicle heard" if self.station.connected else self.station.link_error or "no vehicle heard"
            if now != status:
                status = now
                self._notifier.status(f"{self.config.vehicle.source}: {status}")
            await asyncio.sleep(every_s)

    def _is_stuck(self) -> bool:
        assert self._loop is not None
        beat, now_s = self.station.beat, self._loop.time()
        self._beaten_s = {beat: self._beaten_s.get(beat, now_s)}
        return now_s - self._beaten_s[beat] > STUCK_S


def _keep_private(folder: Path) -> None:
    """Let nobody else read what the service writes, by any of its modules or children, or wrote before.

    Recordings tell where a vehicle was, undo files what it is set to. Raises UsageError.
    """
    os.umask(0o077)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, mode in (("history.db*", 0o600), *((name, 0o700) for name in _FOLDERS)):
            for path in folder.glob(name):
                path.chmod(mode)
    except OSError as error:
        raise UsageError(
            f"The folder {folder} cannot be used ({error.strerror}).",
            "Make it writable for this user, or name another with --storage.",
        ) from error


def link_opener(config: ServiceConfig) -> OpenLink:
    """Build the function that opens the configured link, and opens it again."""
    address = parse_address(config.vehicle.source)
    if isinstance(address, Simulated):
        from mavcompass.vehicle.links.simulated import SimulatedLink

        simulated = SimulatedLink.of(
            address.vehicle, seed=address.seed, effects=address.effects, speed=config.vehicle.speed
        )
        return lambda: simulated  # opening it again must not make another vehicle
    # The station opens a lost link again itself; the link need not be patient.
    patience = Reconnect(first_s=0.0)
    key_file = config.vehicle.sign_key_file
    signing = Signing.of_file(Path(key_file)) if key_file else None

    def open_it() -> Link:
        from mavcompass.vehicle import open_link

        return open_link(address, signing=signing, reconnect=patience)

    return open_it


def _listen(listen: str) -> socket.socket:
    """Bind the page's port. Raises UsageError where it is taken."""
    host, port = split_host_port(listen)
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server((address[0], port), family=family)
    except OSError as error:
        raise UsageError(
            f"The page cannot be served on {listen}: {error.strerror or error}.",
            "Close the other program that uses this port, or choose another with --http HOST:PORT.",
        ) from error
    listener.setblocking(False)
    listen_bounded(listener)
    # asyncio does so only where the socket names its protocol; else an answer waits 40 ms for an ACK.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


class Notifier:
    """Send notifications to the service manager; without one (NOTIFY_SOCKET unset) do nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        # "@" stands for the null byte of Linux's abstract names.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_s = _watchdog_s(environment)

    @property
    def active(self) -> bool:
        """Tell whether a service manager listens."""
        return bool(self._address)

    def ready(self, status: str) -> None:
        """Say that the service does its work."""
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send(f"STATUS={text}")

    def alive(self) -> None:
        """Keep the watchdog from restarting us."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the service is ending as it should."""
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            try:
                sender.sendto(text.encode(), self._address)
            except OSError:
                pass  # the manager went away; it will restart us if it wants


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """Return the watchdog's time, for ever where there is none or it is meant for another process."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return math.inf
    try:
        return int(environment["WATCHDOG_USEC"]) * 1e-6
    except (KeyError, ValueError):
        return math.inf
