"""`mavcompass fleet ...`: many recordings, on one machine or a cluster."""

from __future__ import annotations

from mavcompass.cli.fleet.commands import command

__all__ = ["command"]
