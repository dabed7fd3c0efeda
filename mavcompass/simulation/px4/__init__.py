"""PX4's firmware, as it was seen to behave."""

from mavcompass.simulation.px4.firmware import Px4

__all__ = ["Px4"]
