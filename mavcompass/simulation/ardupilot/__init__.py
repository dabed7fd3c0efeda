"""ArduPilot's firmware, as it was seen to behave."""

from mavcompass.simulation.ardupilot.firmware import ArduPilot

__all__ = ["ArduPilot"]
