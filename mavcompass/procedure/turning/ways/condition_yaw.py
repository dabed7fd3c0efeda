"""Turn on by CONDITION_YAW, in small relative steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.enums import MavCmd
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import RUNS_ON_S, Builder, SteeredTurn


@dataclass(frozen=True, slots=True)
class YawStep:
    """Turn on by CONDITION_YAW in small relative steps: flying copters and diving subs in GUIDED.

    A repeated relative command replaces what is left of the last one, so the steps do not add up. The last
    one is gone on with where the link dies: it is no longer than the rate covers in time.
    """

    step_rad: float = math.radians(8.0)
    ends_within_s: float = 1.0
    name: str = "CONDITION_YAW"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Turn on by a step, at the rate; not farther than what is left, or than it turns in time."""
        in_time_rad = abs(rate_radps) * (self.ends_within_s - RUNS_ON_S)
        self._command(context, min(self.step_rad, in_time_rad, max(left_rad, 0.0)), rate_radps)

    def stand(self, context: Context) -> None:
        """Do nothing: the last step ends by itself and the autopilot holds its yaw."""

    def let_go(self, context: Context) -> None:
        """Hold the present yaw."""
        self._command(context, 0.0, math.radians(30.0))

    def _command(self, context: Context, angle_rad: float, rate_radps: float) -> None:
        context.send(
            mav.CommandLong(
                context.system,
                context.component,
                MavCmd.CONDITION_YAW,
                0,
                math.degrees(angle_rad),
                math.degrees(abs(rate_radps)),
                math.copysign(1.0, rate_radps),
                1.0,
            )
        )


WAYS: dict[str, Builder] = {
    "CONDITION_YAW": lambda way, modes: SteeredTurn.by(
        YawStep(ends_within_s=way.ends_within_s), way, arrives=True
    )
}
