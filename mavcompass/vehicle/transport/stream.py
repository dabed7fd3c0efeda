"""One connection to one peer, opened again when it breaks: TCP clients and serial ports alike."""

from __future__ import annotations

import logging
import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from mavcompass.errors import LinkLost, NoVehicle
from mavcompass.vehicle.transport.transport import READ_BYTES, SEND_BUFFER_BYTES, Peer, Reconnect

_log = logging.getLogger(__name__)


class Opened(Protocol):
    """Be a socket or a serial port that is open."""

    def fileno(self) -> int: ...
    def close(self) -> None: ...


class Stream:
    """Be one open connection: bytes go straight to its file, without waiting; what it would not take is kept.

    Every method but `close` may raise OSError when it broke.
    """

    def __init__(self, opened: Opened) -> None:
        self._opened = opened
        self._waiting = bytearray()
        os.set_blocking(opened.fileno(), False)

    def fileno(self) -> int:
        """Return the file to wait for."""
        return self._opened.fileno()

    @property
    def has_waiting(self) -> bool:
        """Tell whether something is yet to be sent."""
        return bool(self._waiting)

    def read(self) -> bytes:
        """Send what is waiting, and return what has come, b"" for nothing. Raises EOFError at the end."""
        self._flush()
        try:
            data = os.read(self.fileno(), READ_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise EOFError("closed by the other end")
        return data

    def write(self, data: bytes) -> bool:
        """Send after what is waiting; False when too much is."""
        if len(self._waiting) + len(data) > SEND_BUFFER_BYTES:
            return False
        self._waiting += data
        self._flush()
        return True

    def _flush(self) -> None:
        with suppress(BlockingIOError):
            while self._waiting:
                del self._waiting[: os.write(self.fileno(), self._waiting)]

    def close(self) -> None:
        """Let go."""
        with suppress(OSError):
            self._opened.close()


class StreamTransport:
    """Carry bytes over one connection; `peers()` is empty while it is broken."""

    PEER: Peer = "peer"

    def __init__(self, name: str, opening: Callable[[], Opened], reconnect: Reconnect, remedy: str) -> None:
        self.name = name
        self._open = opening
        self._reconnect = reconnect
        self._remedy = remedy
        self._stream: Stream | None = None
        self._closed = False
        self._give_up_s = self._next_try_s = time.monotonic()
        self._connect_first()

    def _connect_first(self) -> None:
        give_up_s = time.monotonic() + self._reconnect.first_s
        while True:
            try:
                self._stream = Stream(self._open())
                return
            except OSError as error:
                if time.monotonic() >= give_up_s:
                    reason = error.strerror or str(error)
                    raise NoVehicle(f"{self.name} could not be opened: {reason}.", self._remedy) from error
            time.sleep(self._reconnect.every_s)

    def wait(self, timeout_s: float) -> None:
        """Return when something may have come, or after the time; opens a broken connection again."""
        if self._stream is None:
            pause = min(timeout_s, max(self._next_try_s - time.monotonic(), 0.0))
            time.sleep(pause)
            self._try_again()
            return
        poll = select.poll()
        poll.register(
            self._stream.fileno(), select.POLLIN | (select.POLLOUT if self._stream.has_waiting else 0)
        )
        poll.poll(max(timeout_s, 0.0) * 1000.0)

    def read(self) -> list[tuple[Peer, bytes]]:
        """Return what has come. Raises LinkLost when the connection stayed broken."""
        if self._closed:
            raise LinkLost(f"{self.name} is closed.")
        if self._stream is None:
            self._try_again()
        if self._stream is None:
            return []
        try:
            data = self._stream.read()
        except (OSError, EOFError) as error:
            self._broke(error)
            return []
        return [(self.PEER, data)] if data else []

    def write(self, data: bytes, peer: Peer) -> bool:
        """Send, or say that it could not be taken."""
        if self._stream is None:
            return False
        try:
            return self._stream.write(data)
        except OSError as error:
            self._broke(error)
            return False

    def peers(self) -> list[Peer]:
        """Name the one peer, if it is there."""
        return [] if self._stream is None else [self.PEER]

    def hang_up(self) -> None:
        """Close the connection; it is opened again."""
        if self._stream is not None:
            self._broke(EOFError("hung up by us"))

    def close(self) -> None:
        """Close the connection for good."""
        self._closed = True
        self._drop()

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream = None

    def _broke(self, error: Exception) -> None:
        _log.info("%s broke (%s), trying again", self.name, error)
        self._drop()
        self._next_try_s = time.monotonic() + self._reconnect.every_s
        self._give_up_s = time.monotonic() + self._reconnect.again_s

    def _try_again(self) -> None:
        now = time.monotonic()
        if now < self._next_try_s:
            return
        self._next_try_s = now + self._reconnect.every_s
        try:
            self._stream = Stream(self._open())
            _log.info("%s is open again", self.name)
        except OSError as error:
            if now >= self._give_up_s:
                raise LinkLost(f"{self.name} closed and could not be opened again.", self._remedy) from error
