"""Ask for a yaw rate by SET_ATTITUDE_TARGET."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import Builder, SteeredTurn

# type_mask: only the yaw rate and the thrust count.
_YAW_RATE_ONLY = 0x83


@dataclass(frozen=True, slots=True)
class AttitudeRate:
    """Ask for a yaw rate by SET_ATTITUDE_TARGET without thrust: rovers and boats."""

    name: str = "attitude targets"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for the rate."""
        context.send(
            mav.SetAttitudeTarget(
                target_system=context.system,
                target_component=context.component,
                type_mask=_YAW_RATE_ONLY,
                body_yaw_rate=rate_radps,
            )
        )

    def stand(self, context: Context) -> None:
        """Ask for no rate."""
        self.turn(context, 0.0, 0.0)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


WAYS: dict[str, Builder] = {"attitude targets": lambda way, modes: SteeredTurn.by(AttitudeRate(), way)}
