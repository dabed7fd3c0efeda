"""From a port's address to an open transport."""

from __future__ import annotations

from mavcompass.vehicle.transport.address import Serial, Tcp, TcpIn, UdpIn, UdpOut, WireAddress
from mavcompass.vehicle.transport.transport import Reconnect, Transport


def open_transport(address: WireAddress, reconnect: Reconnect | None = None) -> Transport:
    """Open a port. Raises UsageError or NoVehicle."""
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
