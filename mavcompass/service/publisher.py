"""Send every heading to other programs of this machine: one JSON datagram each."""

from __future__ import annotations

import math
import socket

from mavcompass.heading.live import Heading
from mavcompass.service.config import split_host_port

_DEG = 180.0 / math.pi


class HeadingPublisher:
    """Send headings to a UDP address; nobody needs to listen there."""

    def __init__(self, address: str) -> None:
        """Take "udp:HOST:PORT"; raises OSError for an unknown host."""
        host, port = split_host_port(address.removeprefix("udp:"))
        family, kind, _, _, target = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)
        self._target = target

    def publish(self, heading: Heading) -> None:
        """Send one heading; what cannot be sent is left."""
        try:
            self._socket.sendto(datagram(heading), self._target)
        except OSError:
            pass  # nobody listens, or the buffer is full: the next one comes soon

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def datagram(heading: Heading) -> bytes:
    """Write a heading as JSON; degrees, the vehicle's clock in seconds."""
    true = "null" if heading.true_rad is None else f"{heading.true_rad * _DEG:.3f}"
    return (
        f'{{"boot_s":{heading.boot_s:.6f},"compass":{heading.instance},'
        f'"magnetic_deg":{heading.magnetic_rad * _DEG:.3f},"true_deg":{true},'
        f'"sigma_deg":{heading.sigma_rad * _DEG:.3f}}}'
    ).encode()
