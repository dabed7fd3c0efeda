"""Ask for a yaw rate: bare, at a standstill (copters, subs), or on an arc for what cannot pivot."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.enums import MavFrame
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import Builder, SteeredTurn
from mavcompass.procedure.turning.targets import STAND_AND_YAW_RATE, YAW_RATE_ONLY, send_target


@dataclass(frozen=True, slots=True)
class YawRate:
    """Ask for a yaw rate by SET_POSITION_TARGET_LOCAL_NED.

    Attributes:
        type_mask: what is to be ignored; rovers take a bare yaw rate, copters want a velocity with it.
        forward_mps: speed while turning, for what cannot turn on the spot.
    """

    type_mask: int = YAW_RATE_ONLY
    forward_mps: float = 0.0
    name: str = "yaw rate targets"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for the rate."""
        # BODY_OFFSET_NED is the frame in which a forward speed is the vehicle's own.
        frame = MavFrame.BODY_OFFSET_NED if self.forward_mps else MavFrame.BODY_NED
        send_target(context, self.type_mask, frame, yaw_rate_radps=rate_radps, forward_mps=self.forward_mps)

    def stand(self, context: Context) -> None:
        """Ask for no rate and no speed."""
        send_target(context, self.type_mask)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


WAYS: dict[str, Builder] = {
    "yaw rate targets": lambda way, modes: SteeredTurn.by(YawRate(), way),
    "yaw rate targets at a standstill": lambda way, modes: SteeredTurn.by(
        YawRate(STAND_AND_YAW_RATE, name=way.name), way
    ),
    "slow arcs": lambda way, modes: SteeredTurn.by(
        YawRate(STAND_AND_YAW_RATE, forward_mps=way.forward_mps, name=way.name), way
    ),
}
