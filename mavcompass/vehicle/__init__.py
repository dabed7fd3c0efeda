"""The only place with MAVLink on a wire: links, codec, autopilot dialects, transactions."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mavcompass.track import Track
    from mavcompass.vehicle.address import Address
    from mavcompass.vehicle.framing import Signing
    from mavcompass.vehicle.link import Identity, Link
    from mavcompass.vehicle.transport import Reconnect


def open_link(
    source: str | Address,
    identity: Identity | None = None,
    *,
    signing: Signing | None = None,
    reconnect: Reconnect | None = None,
    read_track: Callable[[Path], Track] | None = None,
) -> Link:
    """Open the link that a SOURCE names; the caller closes it (it is a context manager).

    `identity` is who we are, by default the vehicle's onboard computer. `signing` and `reconnect` are for
    links on a wire; `read_track` (`mavcompass.logs.read_track`) for playing recordings that are not .tlog.

    Raises UsageError for a wrong address, NoVehicle where nothing listens, BadRecording for a bad file.
    """
    from mavcompass.vehicle import opening

    return opening.open_link(source, identity, signing, reconnect, read_track)
