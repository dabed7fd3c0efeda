"""One connection to one peer, opened again when it breaks: TCP clients and serial ports alike."""

from __future__ import annotations

import logging
import select
import time
from contextlib import suppress

from mavcompass.errors import LinkLost, NoVehicle
from mavcompass.vehicle.transport.transport import SEND_BUFFER_BYTES, OpenStream, Peer, Reconnect, Stream

_log = logging.getLogger(__name__)


class SendBuffer:
    """Keep what a stream would not take at once."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def __len__(self) -> int:
        return len(self._waiting)

    def write(self, stream: Stream, data: bytes) -> bool:
        """Send after what is waiting; False when too much is. Raises OSError when the stream broke."""
        if len(self._waiting) + len(data) > SEND_BUFFER_BYTES:
            return False
        self._waiting += data
        self.flush(stream)
        return True

    def flush(self, stream: Stream) -> None:
        """Send what the stream takes now."""
        while self._waiting:
            try:
                sent = stream.write(bytes(self._waiting))
            except BlockingIOError:
                return
            if not sent:
                return
            del self._waiting[:sent]


class StreamTransport:
    """Carry bytes over one connection; `peers()` is empty while it is broken."""

    PEER: Peer = "peer"

    def __init__(self, name: str, open_stream: OpenStream, reconnect: Reconnect, remedy: str) -> None:
        self.name = name
        self._open_stream = open_stream
        self._reconnect = reconnect
        self._remedy = remedy
        self._stream: Stream | None = None
        self._buffer = SendBuffer()
        self._closed = False
        self._give_up_s = self._next_try_s = 0.0
        self._connect_first()

    def _connect_first(self) -> None:
        give_up_s = time.monotonic() + self._reconnect.first_s
        while True:
            try:
                self._stream = self._open_stream()
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
        poll.register(self._stream.fileno(), select.POLLIN | (select.POLLOUT if len(self._buffer) else 0))
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
            self._buffer.flush(self._stream)
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
            return self._buffer.write(self._stream, data)
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
            with suppress(OSError):
                self._stream.close()
        self._stream, self._buffer = None, SendBuffer()

    def _broke(self, error: Exception) -> None:
        _log.info("%s broke (%s), trying again", self.name, error or "closed by the other end")
        self._drop()
        self._next_try_s = time.monotonic() + self._reconnect.every_s
        self._give_up_s = time.monotonic() + self._reconnect.again_s

    def _try_again(self) -> None:
        now = time.monotonic()
        if now < self._next_try_s:
            return
        self._next_try_s = now + self._reconnect.every_s
        try:
            self._stream = self._open_stream()
            _log.info("%s is open again", self.name)
        except OSError as error:
            if now >= self._give_up_s:
                raise LinkLost(f"{self.name} closed and could not be opened again.", self._remedy) from error
