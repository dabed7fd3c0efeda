"""Who turns the vehicle, whether it may and what that takes, and what ends a motion at once."""

from __future__ import annotations

from mavcompass.procedure.motion.mobility import Mobility, Motion
from mavcompass.procedure.motion.readiness import Permissions, Readiness

__all__ = [
    "Mobility",
    "Motion",
    "Permissions",
    "Readiness",
]
