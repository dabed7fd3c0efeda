"""What `replay` and `simulate` share: a vehicle at a port, for any number of clients."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import Number

if TYPE_CHECKING:
    from mavcompass.vehicle.links.server import VehicleServer
    from mavcompass.vehicle.transport import Transport, WireAddress

listen_option = click.option(
    "--listen",
    "where",
    required=True,
    metavar="ADDRESS",
    help="tcp:HOST:PORT or udpin:HOST:PORT wait for clients; udpout:HOST:PORT speaks first.",
)
speed_option = click.option(
    "--speed",
    type=Number(0.01, 1000.0),
    default=1.0,
    show_default=True,
    help="2 is twice real time.",
)
quiet_option = click.option("--quiet", is_flag=True, help="Do not say where it listens.")


def serve(
    address: WireAddress, at: Callable[[Transport], VehicleServer], say: Callable[[str], None]
) -> dict[str, object]:
    """Serve a vehicle at an address until its end, Ctrl-C or SIGTERM; return what a program is told of it.

    Args:
        at: puts the vehicle at the open port.
        say: tells a person where the port is.
    """
    from mavcompass.vehicle.stopping import StopRequest, stop_signals
    from mavcompass.vehicle.transport import open_transport

    stop = StopRequest()
    with closing(open_transport(address)) as transport:
        server = at(transport)
        with stop_signals(stop):
            say(transport.name)
            server.serve(stop)
    heard = server.statistics
    return {
        "address": transport.name,
        "received": heard.received,
        "malformed": heard.malformed,
        "dropped": heard.dropped,
    }
