"""The only place with MAVLink on a wire: links, codec, autopilot dialects, transactions."""

from mavcompass.vehicle.opening import open_link

__all__ = ["open_link"]
