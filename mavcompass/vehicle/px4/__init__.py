"""PX4's compass parameters: read, planned and written."""

from mavcompass.vehicle.px4.dialect import PX4Dialect

__all__ = ["PX4Dialect"]
