"""Who steers an ArduPilot vehicle in which mode, and what it makes of targets in GUIDED."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag

from mavcompass.enums import MavFrame
from mavcompass.frames import wrap_angle
from mavcompass.messages import SetAttitudeTarget, SetPositionTargetLocalNed
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.modes import ModeRules
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import (
    GroundGuidance,
    HoverGuidance,
    Ignore,
    Radio,
    Target,
    stick,
)
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.physics.motion import Drive

_CLIMB_MPS, _DESCEND_MPS, _LAND_MPS, _FALL_MPS = 2.5, 1.5, 0.5, 4.0
_LAND_SLOWLY_BELOW_M = 5.0
_RETURN_HEIGHT_M = 15.0
_PILOT_YAW_RADPS = math.radians(100.0)
_LOW_STICK = 1100
_BODY_FRAMES = (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED)


class IgnoreAttitude(IntFlag):
    """Name the bits of SET_ATTITUDE_TARGET's type_mask."""

    YAW_RATE = 4
    THROTTLE = 64
    ATTITUDE = 128


@dataclass(slots=True, eq=False)
class Steering:
    """Turn mode, targets and sticks into what the chassis shall do."""

    board: Board
    status: Status
    store: ParameterStore
    rules: ModeRules
    radio: Radio
    ground: GroundGuidance
    hover: HoverGuidance
    arming: Arming
    _returning_home: bool = field(default=False, init=False)

    def take_position_target(self, message: SetPositionTargetLocalNed) -> None:
        """Take a GUIDED target; what hovers ignores those that have no velocity."""
        target = position_target(self.board, message)
        if target is None:
            return
        if not self.board.profile.hovers:
            self.ground.set_target(target)
        elif _with_velocity(message) and self.status.armed and not self.board.body.landed:
            self.hover.set_target(target, math.radians(self.store.get("ATC_SLEW_YAW", 6000.0) / 100.0))

    def take_attitude_target(self, message: SetAttitudeTarget) -> None:
        """Take a GUIDED attitude, as rovers do."""
        if not self.board.profile.hovers and (target := attitude_target(self.board, message)):
            self.ground.set_target(target)

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        if not self.status.armed:
            return Drive()
        if self.board.profile.chassis == "copter":
            return self._fly(dt_s)
        if self.board.profile.chassis == "sub":
            return self._dive(dt_s)
        return self._drive(dt_s)

    def _drive(self, dt_s: float) -> Drive:
        p, store = self.board.profile, self.store
        if self.status.mode == "GUIDED":
            gain = p.yaw_gain_per_s * store["ATC_STR_ANG_P"] / 2.0
            rate = min(math.radians(store["ATC_STR_RAT_MAX"]), p.yaw_rate_max_radps)
            acceleration = min(math.radians(store["ATC_STR_ACC_MAX"]), p.yaw_acceleration_radps2)
            return self.ground.guided(dt_s, gain, rate, acceleration)
        if self.status.mode in self.rules.by_hand:
            now = self.board.boot_time_s
            return self.ground.by_hand(self.radio.channel(1, now), self.radio.channel(3, now))
        return Drive()

    def _fly(self, dt_s: float) -> Drive:
        body = self.board.body
        if body.landed and body.climb_mps <= 0.0 and not self._wants_to_climb():
            self._returning_home = False
            if self.hover.idle(dt_s, self.status.mode, self.store.get("DISARM_DELAY", 10.0)):
                self.arming.disarm()
            return Drive(motors_on=self.status.armed)
        now = self.board.boot_time_s
        by_hand = 0.0
        if self.status.mode in self.rules.by_hand:
            by_hand = stick(self.radio.channel(4, now)) * _PILOT_YAW_RADPS
        if body.landed:
            self.hover.hold()
        return Drive(
            self.hover.yaw_rate(dt_s, by_hand),
            self.hover.speed_mps if self.status.mode == "GUIDED" else 0.0,
            self._climb(now),
            motors_on=True,
        )

    def _wants_to_climb(self) -> bool:
        height = self.hover.height_m
        return self.status.mode == "GUIDED" and height is not None and height > 0.0

    def _climb(self, now_s: float) -> float:
        height = self.board.body.height_m
        if self.status.mode in ("GUIDED", "BRAKE"):
            return self.hover.climb_rate(_CLIMB_MPS, _DESCEND_MPS)
        if self.status.mode == "RTL" and height < _RETURN_HEIGHT_M and not self._returning_home:
            return _CLIMB_MPS
        if self.status.mode in ("LAND", "RTL"):
            self._returning_home = self.status.mode == "RTL"
            return -_LAND_MPS if height < _LAND_SLOWLY_BELOW_M else -_DESCEND_MPS
        # By hand: the throttle stick's middle holds the height; at the bottom it comes down.
        throttle = self.radio.channel(3, now_s)
        if self.status.mode == "STABILIZE" and throttle < _LOW_STICK:
            return -_FALL_MPS
        speed = stick(throttle)
        return speed * (_CLIMB_MPS if speed > 0.0 else _DESCEND_MPS)

    def _dive(self, dt_s: float) -> Drive:
        now = self.board.boot_time_s
        if self.status.mode == "GUIDED":
            rate = self.hover.yaw_rate(dt_s)
            return Drive(rate, self.hover.speed_mps, self.hover.climb_rate(0.5, 0.5), motors_on=True)
        if self.status.mode == "SURFACE":
            return Drive(self.hover.yaw_rate(dt_s), 0.0, 0.5, motors_on=True)
        by_hand = stick(self.radio.channel(4, now)) * _PILOT_YAW_RADPS
        climb = 0.5 * stick(self.radio.channel(3, now))
        if self.status.mode == "MANUAL":
            return Drive(by_hand or None, 0.0, climb, motors_on=bool(by_hand or climb))
        return Drive(self.hover.yaw_rate(dt_s, by_hand), 0.0, climb, motors_on=True)


def _with_velocity(message: SetPositionTargetLocalNed) -> bool:
    return message.type_mask & Ignore.VELOCITY != Ignore.VELOCITY


def yaw_of(q: Sequence[float]) -> float:
    """Return the yaw of a quaternion (w, x, y, z)."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def position_target(board: Board, message: SetPositionTargetLocalNed) -> Target | None:
    """Read a target off SET_POSITION_TARGET_LOCAL_NED; None where it asks for no turn or speed."""
    mask = message.type_mask
    body = message.coordinate_frame in _BODY_FRAMES
    yaw_wanted, rate_wanted = not mask & Ignore.YAW, not mask & Ignore.YAW_RATE
    with_velocity = _with_velocity(message)
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
    if not mask & IgnoreAttitude.ATTITUDE and all(math.isfinite(v) for v in message.q):
        return Target(now, heading_rad=yaw_of(message.q), speed_mps=speed)
    return None
