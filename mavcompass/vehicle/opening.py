"""From an address to an open link; what a kind of link needs is imported when one is opened."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.vehicle.transport import (
    Address,
    Mavsdk,
    Recording,
    Serial,
    Simulated,
    Tcp,
    TcpIn,
    UdpIn,
    UdpOut,
    parse_address,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mavcompass.track import Track
    from mavcompass.vehicle.link import Identity, Link
    from mavcompass.vehicle.transport import Reconnect
    from mavcompass.vehicle.wire import Signing


def open_link(
    source: str | Address,
    identity: Identity | None = None,
    signing: Signing | None = None,
    reconnect: Reconnect | None = None,
    read_track: Callable[[Path], Track] | None = None,
) -> Link:
    """Open the link that a SOURCE names; the caller closes it (it is a context manager).

    `identity` is who we are, by default the vehicle's onboard computer. `signing` and `reconnect` are for
    links on a wire; `read_track` (`mavcompass.logs.read_track`) for playing recordings that are not .tlog.

    Raises UsageError for a wrong address, NoVehicle where nothing listens, BadRecording for a bad file.
    """
    from mavcompass.vehicle.link import ONBOARD_COMPUTER

    address = parse_address(source) if isinstance(source, str) else source
    identity = ONBOARD_COMPUTER if identity is None else identity
    match address:
        case Simulated(vehicle, seed, effects):
            from mavcompass.vehicle.links.simulated import SimulatedLink

            return SimulatedLink.of(vehicle, seed=seed, effects=effects, identity=identity)
        case Recording(path):
            from mavcompass.vehicle.replay import ReplayedLink

            return ReplayedLink.playing(path, read_track, identity)
        case Mavsdk(url):
            from mavcompass.vehicle.links.wire import WireLink
            from mavcompass.vehicle.transport.mavsdk import MavsdkTransport

            return WireLink(MavsdkTransport(url), identity, signing)
        case UdpIn() | UdpOut() | Tcp() | TcpIn() | Serial():
            from mavcompass.vehicle.links.wire import WireLink
            from mavcompass.vehicle.transport import open_transport

            return WireLink(open_transport(address, reconnect), identity, signing)
