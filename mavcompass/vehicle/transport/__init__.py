"""Bytes to and from peers over UDP, TCP and serial ports, and the addresses that name them."""

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
from mavcompass.vehicle.transport.opening import open_transport
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
