"""A recording played as if its vehicle were there."""

from mavcompass.vehicle.replay.alterations import Alterations
from mavcompass.vehicle.replay.replayed import ReplayedLink, replayed_autopilot

__all__ = ["Alterations", "ReplayedLink", "replayed_autopilot"]
