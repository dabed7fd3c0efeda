"""A vehicle served on a real port by a thread of this process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mavcompass.messages import Message
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.links.autopilot import Autopilot
from mavcompass.vehicle.links.server import Record, VehicleServer
from mavcompass.vehicle.stopping import StopRequest
from mavcompass.vehicle.transport import TcpIn, Transport, WireAddress, open_transport

ANY_TCP_PORT = TcpIn("127.0.0.1", 0)


def port_of(transport: Transport) -> int:
    return int(transport.name.rpartition(":")[2])


@contextmanager
def serving(
    autopilot: Autopilot,
    address: WireAddress = ANY_TCP_PORT,
    speed: float = 1.0,
    record: Record | None = None,
) -> Iterator[tuple[VehicleServer, int]]:
    """Give the server and its port; what it raises fails the test."""
    transport = open_transport(address)
    if isinstance(autopilot, SimulatedAutopilot):
        autopilot.moor(transport.name)  # tests run side by side, each with a vehicle of its own
    server = VehicleServer(
        autopilot,
        transport,
        speed=speed,
        record=record,
        is_rebooting=lambda: getattr(autopilot, "silent_until_us", None) is not None,
    )
    stop = StopRequest()
    errors: list[BaseException] = []

    def work() -> None:
        try:
            server.serve(stop)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield server, port_of(transport)
    finally:
        stop.reason = "The test is over."
        thread.join(30.0)
        transport.close()
    assert not thread.is_alive() and not errors, errors


def hear(link: Link, kind: type[Message], timeout_s: float = 30.0) -> Message:
    """Wait for a message of this kind."""
    end_s = link.now() + timeout_s
    while link.now() < end_s:
        incoming = link.receive(0.2)
        if incoming is not None and type(incoming.message) is kind:
            return incoming.message
    raise AssertionError(f"no {kind.__name__} within {timeout_s} s")
