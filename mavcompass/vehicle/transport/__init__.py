"""Bytes to and from peers over UDP, TCP and serial ports, and the addresses that name them."""

from __future__ import annotations

from mavcompass.vehicle.transport.address import (
    VEHICLES,
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
    listening_address,
    parse_address,
)
from mavcompass.vehicle.transport.transport import Peer, Reconnect, Transport

__all__ = [
    "VEHICLES",
    "Address",
    "Mavsdk",
    "Peer",
    "Reconnect",
    "Recording",
    "Serial",
    "Simulated",
    "Tcp",
    "TcpIn",
    "Transport",
    "UdpIn",
    "UdpOut",
    "WireAddress",
    "listening_address",
    "open_transport",
    "parse_address",
]


def open_transport(address: WireAddress | Mavsdk, reconnect: Reconnect | None = None) -> Transport:
    """Open a port, or what passes frames on. Raises UsageError or NoVehicle."""
    reconnect = Reconnect() if reconnect is None else reconnect
    match address:
        case UdpIn(host, port):
            from mavcompass.vehicle.transport.udp import UdpTransport

            return UdpTransport.listening(host, port)
        case UdpOut(host, port):
            from mavcompass.vehicle.transport.udp import UdpTransport

            return UdpTransport.speaking_to(host, port)
        case Tcp(host, port):
            from mavcompass.vehicle.transport.tcp import connect_tcp

            return connect_tcp(host, port, reconnect)
        case TcpIn(host, port):
            from mavcompass.vehicle.transport.tcp import TcpServerTransport

            return TcpServerTransport(host, port)
        case Serial(device, baud):
            from mavcompass.vehicle.transport.serial import open_serial

            return open_serial(device, baud, reconnect)
        case Mavsdk(url):
            from mavcompass.vehicle.transport.mavsdk import MavsdkTransport

            return MavsdkTransport(url)
