"""SET_POSITION_TARGET_LOCAL_NED, as far as turning needs it."""

from __future__ import annotations

from mavcompass import messages as mav
from mavcompass.enums import MavFrame
from mavcompass.procedure.script import Context

# type_mask: what is to be ignored.
_IGNORE_POSITION = 0x007
_IGNORE_VELOCITY = 0x038
_IGNORE_ACCELERATION = 0x1C0
_IGNORE_YAW = 0x400
_IGNORE_YAW_RATE = 0x800
YAW_ONLY = _IGNORE_POSITION | _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
YAW_RATE_ONLY = _IGNORE_POSITION | _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW
STAND_AND_YAW_RATE = _IGNORE_POSITION | _IGNORE_ACCELERATION | _IGNORE_YAW
PLACE_AND_YAW_RATE = _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW


def send_target(
    context: Context,
    type_mask: int,
    frame: MavFrame = MavFrame.BODY_NED,
    yaw_rad: float = 0.0,
    yaw_rate_radps: float = 0.0,
    forward_mps: float = 0.0,
    place_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Send a target; what the mask ignores stays 0."""
    x, y, z = place_ned_m
    context.send(
        mav.SetPositionTargetLocalNed(
            target_system=context.system,
            target_component=context.component,
            coordinate_frame=frame,
            type_mask=type_mask,
            x=x,
            y=y,
            z=z,
            vx=forward_mps,
            yaw=yaw_rad,
            yaw_rate=yaw_rate_radps,
        )
    )
