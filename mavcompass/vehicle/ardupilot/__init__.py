"""ArduPilot's compass parameters: read, planned and written."""

from mavcompass.vehicle.ardupilot.dialect import ArduPilotDialect

__all__ = ["ArduPilotDialect"]
