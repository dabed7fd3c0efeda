"""Name a heading ahead of the vehicle, again and again."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.enums import MavFrame
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import Builder, SteeredTurn
from mavcompass.procedure.turning.targets import YAW_ONLY, YAW_RATE_ONLY, send_target


@dataclass(frozen=True, slots=True)
class HeadingAhead:
    """Name a heading ahead of the vehicle, again and again: skid-steer rovers and boats in GUIDED.

    Attributes:
        gain_per_s: rate of turn per radian of heading error, as rovers have it (ATC_STR_ANG_P).
        farthest_rad: never name a heading farther ahead.
    """

    gain_per_s: float = 2.0
    farthest_rad: float = math.radians(45.0)
    name: str = "heading targets"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Name the heading whose error makes the vehicle turn at the rate."""
        ahead = max(-self.farthest_rad, min(self.farthest_rad, rate_radps / self.gain_per_s))
        send_target(context, YAW_ONLY, MavFrame.BODY_OFFSET_NED, yaw_rad=ahead)

    def stand(self, context: Context) -> None:
        """Ask for no rate: no heading is held, so a yaw that the bad compass bends is not hunted after."""
        send_target(context, YAW_RATE_ONLY)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


WAYS: dict[str, Builder] = {
    "heading targets": lambda way, modes: SteeredTurn.by(HeadingAhead(way.gain_per_s), way)
}
