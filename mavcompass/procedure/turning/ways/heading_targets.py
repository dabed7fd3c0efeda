"""Name a heading ahead of the vehicle, again and again."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.enums import MavFrame
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import RUNS_ON_S, SLOW_RADPS, Builder, SteeredTurn
from mavcompass.procedure.turning.targets import YAW_ONLY, YAW_RATE_ONLY, send_target

# Far from half a turn, beyond which it would be the other way round.
_FARTHEST_RAD = math.radians(90.0)


@dataclass(frozen=True, slots=True)
class HeadingAhead:
    """Name a heading ahead of the vehicle, again and again: skid-steer rovers and boats in GUIDED.

    What was named last is where a vehicle goes whose link dies, at the rate gain times what is left. So no
    heading is named that is farther ahead than it takes to be slow again in time, however slowly it turns.

    Attributes:
        gain_per_s: rate of turn per radian of heading error, as rovers have it (ATC_STR_ANG_P).
        ends_within_s: the vehicle stands so soon after the last word.
    """

    gain_per_s: float = 2.0
    ends_within_s: float = 1.0
    name: str = "heading targets"

    @property
    def farthest_rad(self) -> float:
        """Return how far ahead a heading may be: rate(t) = gain * farthest * exp(-gain t) is slow in time."""
        in_time = SLOW_RADPS / self.gain_per_s * math.exp(self.gain_per_s * (self.ends_within_s - RUNS_ON_S))
        return min(in_time, _FARTHEST_RAD)

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
    "heading targets": lambda way, modes: SteeredTurn.by(HeadingAhead(way.gain_per_s, way.ends_within_s), way)
}
