"""What ArduPilot makes of SET_POSITION_TARGET_LOCAL_NED and SET_ATTITUDE_TARGET in GUIDED."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntFlag

from mavcompass.enums import MavFrame
from mavcompass.messages import SetAttitudeTarget, SetPositionTargetLocalNed
from mavcompass.simulation.autopilot import Board, Ignore, Target, wrap_angle

_BODY_FRAMES = (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED)


class IgnoreAttitude(IntFlag):
    """Name the bits of SET_ATTITUDE_TARGET's type_mask."""

    YAW_RATE = 4
    THROTTLE = 64
    ATTITUDE = 128


def yaw_of(q: Sequence[float]) -> float:
    """Return the yaw of a quaternion (w, x, y, z)."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def position_target(board: Board, message: SetPositionTargetLocalNed) -> Target | None:
    """Read a target off SET_POSITION_TARGET_LOCAL_NED; None where it asks for no turn or speed."""
    mask = message.type_mask
    body = message.coordinate_frame in _BODY_FRAMES
    yaw_wanted, rate_wanted = not mask & Ignore.YAW, not mask & Ignore.YAW_RATE
    with_velocity = mask & Ignore.VELOCITY != Ignore.VELOCITY
    vx, vy = (message.vx, message.vy) if with_velocity else (0.0, 0.0)
    numbers = (vx, vy, *([message.yaw] * yaw_wanted), *([message.yaw_rate] * rate_wanted))
    if not all(math.isfinite(v) for v in numbers):
        return None
    now, yaw = board.boot_time_s, board.filter.yaw_rad
    speed = math.hypot(vx, vy)
    if body and vx < 0.0:
        speed = -speed
    if yaw_wanted:
        heading = yaw + message.yaw if body else message.yaw
        return Target(now, heading_rad=wrap_angle(heading), speed_mps=speed)
    if rate_wanted:
        return Target(now, rate_radps=message.yaw_rate, speed_mps=speed)
    if not with_velocity:
        return None
    course = math.atan2(vy, vx) + (yaw if body else 0.0) if speed else yaw
    return Target(now, heading_rad=wrap_angle(course), speed_mps=abs(speed))


def attitude_target(board: Board, message: SetAttitudeTarget) -> Target | None:
    """Read a target off SET_ATTITUDE_TARGET, as rovers do; it must not ignore the thrust."""
    mask = message.type_mask
    if mask & IgnoreAttitude.THROTTLE or not math.isfinite(message.thrust):
        return None
    now = board.boot_time_s
    speed = message.thrust * board.profile.speed_max_mps
    if not mask & IgnoreAttitude.YAW_RATE:
        rate = message.body_yaw_rate
        return Target(now, rate_radps=rate, speed_mps=speed) if math.isfinite(rate) else None
    if not mask & IgnoreAttitude.ATTITUDE:
        if all(math.isfinite(v) for v in message.q):
            return Target(now, heading_rad=yaw_of(message.q), speed_mps=speed)
    return None
