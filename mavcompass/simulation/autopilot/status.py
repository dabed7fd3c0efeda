"""What the parts of a firmware know of each other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Status:
    """Hold the vehicle's state as its firmware sees it.

    Attributes:
        failsafe: the heartbeat says CRITICAL. reboot_wanted: reboot once the command is acknowledged.
    """

    mode: str
    armed: bool = False
    battery_low: bool = False
    failsafe: bool = False
    reboot_wanted: bool = False
