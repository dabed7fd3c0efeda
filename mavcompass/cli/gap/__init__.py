"""`mavcompass gap ...`: the gap between the simulation and a recording."""

from __future__ import annotations

from mavcompass.cli.gap.closing import compare
from mavcompass.cli.gap.commands import command

command.add_command(compare)

__all__ = ["command"]
