"""`mavcompass params`: show, compare, write, back up and restore compass parameters."""

from __future__ import annotations

from mavcompass.cli.params.commands import command

__all__ = [
    "command",
]
