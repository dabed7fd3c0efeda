"""The other end of every kind of link, for the tests that all links must pass."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from typing import Protocol

from dialogue import MemoryVehicle

from mavcompass.messages import Message
from mavcompass.vehicle.address import Serial, Tcp, TcpIn, UdpIn, UdpOut
from mavcompass.vehicle.codec import decode
from mavcompass.vehicle.framing import FrameParser, FrameWriter
from mavcompass.vehicle.link import Link, LinkStatistics
from mavcompass.vehicle.opening import open_transport
from mavcompass.vehicle.simulated import SimulatedLink
from mavcompass.vehicle.stream import StreamTransport
from mavcompass.vehicle.tcp import TcpServerTransport
from mavcompass.vehicle.transport import Reconnect, Transport
from mavcompass.vehicle.udp import UdpTransport
from mavcompass.vehicle.wire import WireLink

Heard = list[tuple[int, int, Message]]
QUICK = Reconnect(first_s=1.0, again_s=0.2, every_s=0.02)


class FarEnd(Protocol):
    """Be the vehicle's side."""

    def say(self, message: Message, system: int = 1, component: int = 1) -> None: ...
    def heard(self, count: int) -> Heard:
        """Wait a moment for so many messages and return all that came."""

    def leave(self) -> None: ...


class MemoryEnd:
    """Be a vehicle in the same process."""

    def __init__(self, vehicle: MemoryVehicle) -> None:
        self.vehicle = vehicle

    def say(self, message: Message, system: int = 1, component: int = 1) -> None:
        self.vehicle.system, self.vehicle.component = system, component
        self.vehicle.say(message)

    def heard(self, count: int) -> Heard:
        return self.vehicle.heard

    def leave(self) -> None: ...


class WireEnd:
    """Be a vehicle behind a port."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.writers: dict[tuple[int, int], FrameWriter] = {}
        self.parser = FrameParser(LinkStatistics())
        self._heard: Heard = []

    def say(self, message: Message, system: int = 1, component: int = 1) -> None:
        writer = self.writers.setdefault((system, component), FrameWriter())
        self.say_bytes(writer.write(message, system, component))

    def say_bytes(self, data: bytes) -> None:
        self.heard(0)
        for peer in self.transport.peers():
            assert self.transport.write(data, peer)

    def heard(self, count: int) -> Heard:
        end_s = time.monotonic() + 2.0
        while True:
            for _, data in self.transport.read():
                for frame in self.parser.feed(data):
                    message = decode(frame.message_id, frame.payload)
                    assert message is not None
                    self._heard.append((frame.system, frame.component, message))
            if len(self._heard) >= count or time.monotonic() > end_s:
                return self._heard
            self.transport.wait(0.05)

    def leave(self) -> None:
        self.transport.close()


class _PtyMaster:
    def __init__(self, file: int) -> None:
        self._file = file
        os.set_blocking(file, False)

    def fileno(self) -> int:
        return self._file

    def read(self) -> bytes:
        with suppress(BlockingIOError):
            return os.read(self._file, 65_536)
        return b""

    def write(self, data: bytes) -> int:
        return os.write(self._file, data)

    def close(self) -> None:
        os.close(self._file)


@contextmanager
def simulated() -> Iterator[tuple[Link, FarEnd]]:
    vehicle = MemoryVehicle(beats=False)
    with SimulatedLink(vehicle, "memory") as link:
        yield link, MemoryEnd(vehicle)


@contextmanager
def udpin() -> Iterator[tuple[Link, FarEnd]]:
    near = open_transport(UdpIn("127.0.0.1", 0))
    assert isinstance(near, UdpTransport)
    yield from _wire(near, lambda: open_transport(UdpOut("127.0.0.1", near.port)))


@contextmanager
def udpout() -> Iterator[tuple[Link, FarEnd]]:
    far = open_transport(UdpIn("127.0.0.1", 0))
    assert isinstance(far, UdpTransport)
    yield from _wire(open_transport(UdpOut("127.0.0.1", far.port)), lambda: far)


@contextmanager
def tcp() -> Iterator[tuple[Link, FarEnd]]:
    far = open_transport(TcpIn("127.0.0.1", 0))
    assert isinstance(far, TcpServerTransport)
    yield from _wire(open_transport(Tcp("127.0.0.1", far.port), QUICK), lambda: far)


@contextmanager
def tcpin() -> Iterator[tuple[Link, FarEnd]]:
    near = open_transport(TcpIn("127.0.0.1", 0))
    assert isinstance(near, TcpServerTransport)
    yield from _wire(near, lambda: open_transport(Tcp("127.0.0.1", near.port), QUICK))


@contextmanager
def serial() -> Iterator[tuple[Link, FarEnd]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    device = os.ttyname(slave)
    near = open_transport(Serial(device), QUICK)
    os.close(slave)
    yield from _wire(near, lambda: StreamTransport("pty", lambda: _PtyMaster(master), QUICK, ""))


def _wire(near: Transport, make_far: Callable[[], Transport]) -> Iterator[tuple[Link, FarEnd]]:
    link = WireLink(near)
    far = WireEnd(make_far())
    try:
        link.receive(0.0)  # a TCP server takes the connection
        yield link, far
    finally:
        link.close()
        far.leave()


@dataclass(frozen=True)
class Kind:
    """Name a kind of link: how to make one, and whether it can tell that the other end is gone for good."""

    make: Callable[[], AbstractContextManager[tuple[Link, FarEnd]]]
    tells_the_end: bool = False


KINDS = {
    "simulated": Kind(simulated),
    "udpin": Kind(udpin),
    "udpout": Kind(udpout),
    "tcp": Kind(tcp, tells_the_end=True),
    "tcpin": Kind(tcpin),
    "serial": Kind(serial, tells_the_end=True),
}
