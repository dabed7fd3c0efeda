"""From an address to an open link; what a kind of link needs is imported when one is opened."""

from __future__ import annotations

import os
from pathlib import Path
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
    from mavcompass.vehicle.link import Identity, Link
    from mavcompass.vehicle.transport import Reconnect
    from mavcompass.vehicle.wire import Signing

# Names the file with the key that frames on a wire are signed and checked with.
SIGN_KEY_VARIABLE = "MAVCOMPASS_SIGN_KEY"


def _key_of_environment() -> Signing | None:
    from mavcompass.vehicle.wire import Signing

    path = os.environ.get(SIGN_KEY_VARIABLE)
    return Signing.of_file(Path(path)) if path else None


def open_link(
    source: str | Address,
    identity: Identity | None = None,
    signing: Signing | None = None,
    reconnect: Reconnect | None = None,
    speed: float | None = None,
    by_hand: bool = False,
) -> Link:
    """Open the link that a SOURCE names; the caller closes it (it is a context manager).

    `identity` is who we are, by default the vehicle's onboard computer. `signing` and `reconnect` are for
    links on a wire; without `signing` the key is taken from the file that $MAVCOMPASS_SIGN_KEY names, if it
    does. A simulated vehicle's time has a `speed`, as fast as can be where it is None; `by_hand` a person
    turns it.

    Raises UsageError for a wrong address, NoVehicle where nothing listens, BadRecording for a bad file.
    """
    from mavcompass.vehicle.link import ONBOARD_COMPUTER

    address = parse_address(source) if isinstance(source, str) else source
    identity = ONBOARD_COMPUTER if identity is None else identity
    match address:
        case Simulated(vehicle, seed, effects):
            from mavcompass.vehicle.links.simulated import SimulatedLink

            return SimulatedLink.of(
                vehicle, seed=seed, effects=effects, identity=identity, speed=speed, by_hand=by_hand
            )
        case Recording(path):
            from mavcompass.vehicle.replay import ReplayedLink

            return ReplayedLink.playing(path, identity)
        case Mavsdk() | UdpIn() | UdpOut() | Tcp() | TcpIn() | Serial():
            from mavcompass.vehicle.links.wire import WireLink
            from mavcompass.vehicle.transport import open_transport

            signing = signing or _key_of_environment()
            return WireLink(open_transport(address, reconnect), identity, signing)
