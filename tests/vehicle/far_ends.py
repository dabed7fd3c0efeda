"""The other end of every kind of link, for the tests that all links must pass."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from dialogue import HEARTBEAT, MemoryVehicle

from mavcompass.enums import MavAutopilot
from mavcompass.messages import CommandLong, Heartbeat, Message
from mavcompass.vehicle.link import Link, LinkStatistics
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.links.wire import WireLink
from mavcompass.vehicle.replay.answers import survey
from mavcompass.vehicle.replay.replayed import ReplayedAutopilot, ReplayedLink, play_tlog
from mavcompass.vehicle.transport import (
    Reconnect,
    Serial,
    Tcp,
    TcpIn,
    Transport,
    UdpIn,
    UdpOut,
    open_transport,
)
from mavcompass.vehicle.transport.stream import StreamTransport
from mavcompass.vehicle.transport.tcp import TcpServerTransport
from mavcompass.vehicle.transport.udp import UdpTransport
from mavcompass.vehicle.wire import FrameParser, FrameWriter, decode

Heard = list[tuple[int, int, Message]]
SYSTEM = 9
QUICK = Reconnect(first_s=1.0, again_s=0.2, every_s=0.02)


class FarEnd(Protocol):
    """Be the vehicle's side."""

    def say(self, message: Message, system: int = SYSTEM, component: int = 1) -> None: ...
    def heard(self, count: int) -> Heard:
        """Wait a moment for so many messages and return all that came."""

    def beating(self) -> AbstractContextManager[None]:
        """Beat the heart meanwhile, for a link that must be found anew."""

    def leave(self) -> None: ...


class MemoryEnd:
    """Be a vehicle in the same process."""

    def __init__(self, vehicle: MemoryVehicle) -> None:
        self.vehicle = vehicle

    def say(self, message: Message, system: int = SYSTEM, component: int = 1) -> None:
        self.vehicle.system, self.vehicle.component = system, component
        self.vehicle.say(message)

    def heard(self, count: int) -> Heard:
        return self.vehicle.heard

    def beating(self) -> AbstractContextManager[None]:
        return nullcontext()

    def leave(self) -> None: ...


class WireEnd:
    """Be a vehicle behind a port."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.writers: dict[tuple[int, int], FrameWriter] = {}
        self.parser = FrameParser(LinkStatistics())
        self._heard: Heard = []

    def say(self, message: Message, system: int = SYSTEM, component: int = 1) -> None:
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
                self.take(data)
            if len(self._heard) >= count or time.monotonic() > end_s:
                return self._heard
            self.transport.wait(0.05)

    def take(self, data: bytes) -> None:
        for frame in self.parser.feed(data):
            message = decode(frame.message_id, frame.payload)
            if message is not None:
                self._heard.append((frame.system, frame.component, message))

    def beating(self) -> AbstractContextManager[None]:
        return nullcontext()

    def leave(self) -> None:
        self.transport.close()


class _PtyMaster:
    def __init__(self, file: int) -> None:
        self._file = file

    def fileno(self) -> int:
        return self._file

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


class MavsdkEnd(WireEnd):
    """Be a vehicle that MAVSDK finds: by its heartbeat. MAVSDK asks and beats on its own account."""

    def heard(self, count: int) -> Heard:
        end_s = time.monotonic() + 2.0
        while True:
            super().heard(0)
            self._heard[:] = [h for h in self._heard if not _is_mavsdks_own(h[2])]
            if len(self._heard) >= count or time.monotonic() > end_s:
                return self._heard
            self.transport.wait(0.05)


def _is_mavsdks_own(message: Message) -> bool:
    if isinstance(message, Heartbeat):  # unlike ours, MAVSDK's own tell no state
        return message.autopilot == MavAutopilot.INVALID and message.system_status == 0
    return isinstance(message, CommandLong)


@contextmanager
def mavsdk() -> Iterator[tuple[Link, FarEnd]]:
    from mavcompass.vehicle.transport.mavsdk import MavsdkTransport

    transport = open_transport(UdpIn("127.0.0.1", 0))
    assert isinstance(transport, UdpTransport)
    far = MavsdkEnd(transport)
    with WireLink(MavsdkTransport(f"udpout://127.0.0.1:{transport.port}")) as link:
        try:
            yield link, far
        finally:
            far.leave()


def _wire(near: Transport, make_far: Callable[[], Transport]) -> Iterator[tuple[Link, FarEnd]]:
    link = WireLink(near)
    far = WireEnd(make_far())
    try:
        link.receive(0.0)  # a TCP server takes the connection
        yield link, far
    finally:
        link.close()
        far.leave()


def write_tlog(path: Path, lines: Iterable[tuple[float, int, int, Message]]) -> Path:
    """Record (time, system, component, message) as a ground station does."""
    writers: dict[tuple[int, int], FrameWriter] = {}
    with path.open("wb") as file:
        for time_s, system, component, message in lines:
            writer = writers.setdefault((system, component), FrameWriter())
            file.write(round((1.7e9 + time_s) * 1e6).to_bytes(8, "big"))
            file.write(writer.write(message, system, component))
    return path


class ListeningRecording(ReplayedAutopilot):
    """Be the vehicle of a recording and keep what it hears."""

    heard: Heard

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        self.heard.append((system, component, message))
        super().receive(message, system, component, port)


class RecordedEnd:
    """Be a vehicle that has said everything long ago."""

    def __init__(self, recording: ListeningRecording) -> None:
        self.recording = recording

    def say(self, message: Message, system: int = SYSTEM, component: int = 1) -> None:
        raise AssertionError("a recording is over")

    def heard(self, count: int) -> Heard:
        return self.recording.heard

    def beating(self) -> AbstractContextManager[None]:
        return nullcontext()

    def leave(self) -> None: ...


Saying = tuple[Message, int, int]


@contextmanager
def replay(said: Sequence[Saying]) -> Iterator[tuple[Link, FarEnd]]:
    """Play a recording of `said`, between a heartbeat before and one long after."""
    lines: list[tuple[float, int, int, Message]] = [(0.0, SYSTEM, 1, HEARTBEAT), (5.0, SYSTEM, 1, HEARTBEAT)]
    lines[1:1] = [(0.1 + 0.001 * i, system, component, m) for i, (m, system, component) in enumerate(said)]
    with TemporaryDirectory() as folder:
        path = write_tlog(Path(folder) / "said.tlog", lines)
        contents = survey(path)
        recording = ListeningRecording(play_tlog(path, contents), contents)
        recording.heard = []
        with ReplayedLink(recording, "recording") as link:
            assert link.receive(0.05) is not None
            yield link, RecordedEnd(recording)


def greet(link: Link, far: FarEnd) -> None:
    """Some links wait to be spoken to, others speak first, others want a few heartbeats."""
    for _ in range(50):
        far.say(HEARTBEAT)
        link.receive(0.05)
        link.send(Heartbeat())
        if (1, 191, Heartbeat()) in far.heard(0):
            break
    else:
        raise AssertionError("the two ends do not find each other")
    while link.receive(0.1) is not None:
        pass
    far.heard(0).clear()


@dataclass(frozen=True)
class Kind:
    """Name a kind of link: how to make one, and whether it can tell that the other end is gone for good."""

    make: Callable[[], AbstractContextManager[tuple[Link, FarEnd]]] | None
    tells_the_end: bool = False

    @contextmanager
    def talk(self, said: Sequence[Saying] = ()) -> Iterator[tuple[Link, FarEnd]]:
        """Give a link and its other end, which have greeted each other, and the other end says this."""
        if self.make is None:
            with replay(said) as ends:
                yield ends
            return
        with self.make() as (link, far):
            greet(link, far)
            for message, system, component in said:
                far.say(message, system, component)
            yield link, far


KINDS = {
    "simulated": Kind(simulated),
    "udpin": Kind(udpin),
    "udpout": Kind(udpout),
    "tcp": Kind(tcp, tells_the_end=True),
    "tcpin": Kind(tcpin),
    "serial": Kind(serial, tells_the_end=True),
    "mavsdk": Kind(mavsdk),
    "replay": Kind(None, tells_the_end=True),
}
