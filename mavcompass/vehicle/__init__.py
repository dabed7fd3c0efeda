"""The only place with MAVLink on a wire: links, codec, autopilot dialects, transactions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.installation.doors import door

if TYPE_CHECKING:
    from mavcompass.vehicle.opening import open_link as open_link

__getattr__, __dir__ = door(__name__, {"open_link": "opening"})
