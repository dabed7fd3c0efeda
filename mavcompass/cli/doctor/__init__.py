"""`mavcompass doctor`: what on this computer stands in the way, and its remedy."""

from __future__ import annotations

from mavcompass.cli.doctor.commands import command

__all__ = [
    "command",
]
