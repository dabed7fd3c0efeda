"""`mavcompass gap ...`: the gap between the simulation and a recording."""

from __future__ import annotations

from mavcompass.cli.gap.commands import command
from mavcompass.cli.gap.fly import fly

command.add_command(fly)

__all__ = ["command"]
