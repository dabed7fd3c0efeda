"""From an address to an open link."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mavcompass.track import Track
from mavcompass.vehicle.address import (
    Address,
    Mavsdk,
    Recording,
    Serial,
    Simulated,
    Tcp,
    TcpIn,
    UdpIn,
    UdpOut,
    WireAddress,
    parse_address,
)
from mavcompass.vehicle.framing import Signing
from mavcompass.vehicle.link import ONBOARD_COMPUTER, Identity, Link
from mavcompass.vehicle.transport import Reconnect, Transport


def open_link(
    source: str | Address,
    identity: Identity | None = None,
    signing: Signing | None = None,
    reconnect: Reconnect | None = None,
    read_track: Callable[[Path], Track] | None = None,
) -> Link:
    """Open any address; see `mavcompass.vehicle.open_link`."""
    address = parse_address(source) if isinstance(source, str) else source
    identity = ONBOARD_COMPUTER if identity is None else identity
    match address:
        case Simulated(vehicle, seed, effects):
            from mavcompass.vehicle.simulated import SimulatedLink

            return SimulatedLink.of(vehicle, seed=seed, effects=effects, identity=identity)
        case Recording(path):
            from mavcompass.vehicle.replayed import ReplayedLink

            return ReplayedLink.playing(path, read_track, identity)
        case Mavsdk(url):
            from mavcompass.vehicle.mavsdk_link import MavsdkLink

            return MavsdkLink(url, identity)
        case UdpIn() | UdpOut() | Tcp() | TcpIn() | Serial():
            from mavcompass.vehicle.wire import WireLink

            return WireLink(open_transport(address, reconnect), identity, signing)


def open_transport(address: WireAddress, reconnect: Reconnect | None = None) -> Transport:
    """Open a port. Raises UsageError or NoVehicle."""
    reconnect = Reconnect() if reconnect is None else reconnect
    match address:
        case UdpIn(host, port):
            from mavcompass.vehicle.udp import UdpTransport

            return UdpTransport.listening(host, port)
        case UdpOut(host, port):
            from mavcompass.vehicle.udp import UdpTransport

            return UdpTransport.speaking_to(host, port)
        case Tcp(host, port):
            from mavcompass.vehicle.tcp import connect_tcp

            return connect_tcp(host, port, reconnect)
        case TcpIn(host, port):
            from mavcompass.vehicle.tcp import TcpServerTransport

            return TcpServerTransport(host, port)
        case Serial(device, baud):
            from mavcompass.vehicle.serial import open_serial

            return open_serial(device, baud, reconnect)
