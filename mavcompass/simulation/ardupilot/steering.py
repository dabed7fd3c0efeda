"""Who steers an ArduPilot vehicle in which mode."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mavcompass.simulation.autopilot.guidance import Target, stick
from mavcompass.simulation.autopilot.targets import Ignore
from mavcompass.simulation.physics.motion import Drive

if TYPE_CHECKING:
    from mavcompass.simulation.ardupilot.firmware import ArduPilot

_CLIMB_MPS, _DESCEND_MPS, _LAND_MPS, _FALL_MPS = 2.5, 1.5, 0.5, 4.0
_LAND_SLOWLY_BELOW_M = 5.0
_RETURN_HEIGHT_M = 15.0
_PILOT_YAW_RADPS = math.radians(100.0)
_LOW_STICK = 1100


class Steering:
    """Turn mode, targets and sticks into what the chassis shall do."""

    def __init__(self, firmware: ArduPilot) -> None:
        self._fc = firmware
        self._idle_s = 0.0
        self._returning_home = False

    def take_position_target(self, target: Target | None, mask: int) -> None:
        """Take a GUIDED target; what hovers ignores those that have no velocity."""
        fc = self._fc
        if target is None:
            return
        if not fc.vehicle.profile.hovers:
            fc.ground.set_target(target)
        elif mask & Ignore.VELOCITY != Ignore.VELOCITY and fc.armed and not fc.vehicle.body.landed:
            fc.hover.set_target(target, math.radians(fc.store.get("ATC_SLEW_YAW", 6000.0) / 100.0))

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        if not self._fc.armed:
            return Drive()
        if self._fc.vehicle.profile.chassis == "copter":
            return self._fly(dt_s)
        if self._fc.vehicle.profile.chassis == "sub":
            return self._dive(dt_s)
        return self._drive(dt_s)

    def _drive(self, dt_s: float) -> Drive:
        fc, p, store = self._fc, self._fc.vehicle.profile, self._fc.store
        if fc.mode == "GUIDED":
            gain = p.yaw_gain_per_s * store["ATC_STR_ANG_P"] / 2.0
            rate = min(math.radians(store["ATC_STR_RAT_MAX"]), p.yaw_rate_max_radps)
            acceleration = min(math.radians(store["ATC_STR_ACC_MAX"]), p.yaw_acceleration_radps2)
            return fc.ground.guided(dt_s, gain, rate, acceleration)
        if fc.mode in fc.modes.by_hand:
            now = fc.vehicle.boot_time_s
            return fc.ground.by_hand(fc.radio.channel(1, now), fc.radio.channel(3, now))
        return Drive()

    def _fly(self, dt_s: float) -> Drive:
        fc, body = self._fc, self._fc.vehicle.body
        if body.landed and body.climb_mps <= 0.0 and not self._wants_to_climb():
            return self._idle(dt_s)
        self._idle_s = 0.0
        now = fc.vehicle.boot_time_s
        by_hand = 0.0
        if fc.mode in fc.modes.by_hand:
            by_hand = stick(fc.radio.channel(4, now)) * _PILOT_YAW_RADPS
        if body.landed:
            fc.hover.hold()
        return Drive(
            fc.hover.yaw_rate(dt_s, by_hand),
            fc.hover.speed_mps if fc.mode == "GUIDED" else 0.0,
            self._climb(now),
            motors_on=True,
        )

    def _wants_to_climb(self) -> bool:
        height = self._fc.hover.height_m
        return self._fc.mode == "GUIDED" and height is not None and height > 0.0

    def _climb(self, now_s: float) -> float:
        fc, height = self._fc, self._fc.vehicle.body.height_m
        if fc.mode in ("GUIDED", "BRAKE"):
            return fc.hover.climb_rate(_CLIMB_MPS, _DESCEND_MPS)
        if fc.mode == "RTL" and height < _RETURN_HEIGHT_M and not self._returning_home:
            return _CLIMB_MPS
        if fc.mode in ("LAND", "RTL"):
            self._returning_home = fc.mode == "RTL"
            return -_LAND_MPS if height < _LAND_SLOWLY_BELOW_M else -_DESCEND_MPS
        # By hand: the throttle stick's middle holds the height; at the bottom it comes down.
        throttle = fc.radio.channel(3, now_s)
        if fc.mode == "STABILIZE" and throttle < _LOW_STICK:
            return -_FALL_MPS
        speed = stick(throttle)
        return speed * (_CLIMB_MPS if speed > 0.0 else _DESCEND_MPS)

    def _idle(self, dt_s: float) -> Drive:
        """Stand on the ground with the motors idling; disarm after a while."""
        fc = self._fc
        fc.hover.release()
        fc.hover.height_m = None
        self._returning_home = False
        self._idle_s += dt_s
        landed_by_itself = fc.mode in ("LAND", "RTL")
        if self._idle_s >= (2.0 if landed_by_itself else fc.store.get("DISARM_DELAY", 10.0)):
            self._idle_s = 0.0
            fc.disarm()
        return Drive(motors_on=fc.armed)

    def _dive(self, dt_s: float) -> Drive:
        fc, now = self._fc, self._fc.vehicle.boot_time_s
        if fc.mode == "GUIDED":
            rate = fc.hover.yaw_rate(dt_s)
            return Drive(rate, fc.hover.speed_mps, fc.hover.climb_rate(0.5, 0.5), motors_on=True)
        if fc.mode == "SURFACE":
            return Drive(fc.hover.yaw_rate(dt_s), 0.0, 0.5, motors_on=True)
        by_hand = stick(fc.radio.channel(4, now)) * _PILOT_YAW_RADPS
        climb = 0.5 * stick(fc.radio.channel(3, now))
        if fc.mode == "MANUAL":
            return Drive(by_hand or None, 0.0, climb, motors_on=bool(by_hand or climb))
        return Drive(fc.hover.yaw_rate(dt_s, by_hand), 0.0, climb, motors_on=True)
