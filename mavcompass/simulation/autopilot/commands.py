"""Commands as they come over the wire: COMMAND_INT read as COMMAND_LONG, whole numbers in float fields."""

from __future__ import annotations

import math

from mavcompass.messages import CommandInt, CommandLong

# The number in place of a plain 1 or 0 that arms and disarms whatever speaks against it.
FORCE = 21196.0


def whole(value: float) -> int:
    """Read a whole number off a float field; 0 for what is no number."""
    return int(value) if math.isfinite(value) else 0


def as_long(command: CommandInt) -> CommandLong:
    """Read a COMMAND_INT as the COMMAND_LONG of the same meaning (places in degrees)."""
    return CommandLong(
        command.target_system,
        command.target_component,
        command.command,
        0,
        command.param1,
        command.param2,
        command.param3,
        command.param4,
        command.x * 1e-7,
        command.y * 1e-7,
        command.z if math.isfinite(command.z) else 0.0,
    )
