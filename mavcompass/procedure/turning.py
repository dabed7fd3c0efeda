"""Turn strategies: how each kind of vehicle is made to turn on the spot, and stopped.

A strategy commands; the gyro tells whether and how far the vehicle turned. An acknowledgement
proves nothing: ArduCopter accepts CONDITION_YAW in every mode and moves only in some.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame, MavResult
from mavcompass.procedure.commands import command
from mavcompass.procedure.gyro_angle import GyroAngle
from mavcompass.procedure.script import Context, Script, pause

# Autopilots stop 3 s after the last target; a lossy link wants several in that time.
REPEAT_S = 0.2
MOVES_WITHIN_S = 3.0
MOVED_RAD = math.radians(6.0)

# type_mask of SET_POSITION_TARGET_LOCAL_NED: what is to be ignored.
_IGNORE_POSITION = 0x007
_IGNORE_VELOCITY = 0x038
_IGNORE_ACCELERATION = 0x1C0
_IGNORE_YAW = 0x400
_IGNORE_YAW_RATE = 0x800
YAW_RATE_ONLY = _IGNORE_POSITION | _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW
STAND_AND_YAW_RATE = _IGNORE_POSITION | _IGNORE_ACCELERATION | _IGNORE_YAW


class TurnStrategy(Protocol):
    """Turn the vehicle by an angle measured by the gyro."""

    @property
    def name(self) -> str:
        """Return what the person is told."""
        ...

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Turn by about `angle_rad` (clockwise positive); False where the vehicle does not move."""
        ...

    def hold(self, context: Context) -> None:
        """Leave a message that keeps the vehicle where it is; called several times a second."""
        ...

    def halt(self, context: Context) -> None:
        """Leave messages that stop any rotation now."""
        ...


@dataclass(slots=True)
class YawRateTurn:
    """Turn by a commanded yaw rate, closed on the gyro: skid-steer rovers, boats, copters.

    No heading is held, so a yaw that the bad compass bends has nothing to hunt after. The rate falls
    toward the end, so that late telemetry costs degrees, not quarter turns.
    """

    type_mask: int = YAW_RATE_ONLY
    rate_radps: float = math.radians(60.0)
    slowest_radps: float = math.radians(15.0)
    forward_mps: float = 0.0
    name: str = "yaw rate targets"
    _latency_s: float = 0.3

    def _target(self, context: Context, rate_radps: float, forward_mps: float = 0.0) -> None:
        context.send(
            mav.SetPositionTargetLocalNed(
                target_system=context.system,
                target_component=context.component,
                coordinate_frame=MavFrame.BODY_OFFSET_NED if forward_mps else MavFrame.BODY_NED,
                type_mask=self.type_mask,
                vx=forward_mps,
                yaw_rate=rate_radps,
            )
        )

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Command the rate until the gyro says that the rest is what stopping takes."""
        start_rad, start_s = gyro.angle_rad, context.now
        sign = math.copysign(1.0, angle_rad)
        while True:
            turned = (gyro.angle_rad - start_rad) * sign
            left = abs(angle_rad) - turned
            speed = max(gyro.rate_radps * sign, 0.0)
            if left <= speed * self._latency_s:
                break
            if context.now - start_s > MOVES_WITHIN_S and turned < MOVED_RAD:
                self.halt(context)
                return False
            if context.now - start_s > MOVES_WITHIN_S + 4.0 * abs(angle_rad) / self.slowest_radps:
                break
            wanted = min(self.rate_radps, max(self.slowest_radps, left / 0.6))
            self._target(context, sign * wanted, self.forward_mps)
            yield from pause(context, REPEAT_S)
        self.halt(context)
        return True

    def hold(self, context: Context) -> None:
        """Command no rate."""
        self._target(context, 0.0)

    def halt(self, context: Context) -> None:
        """Command no rate, twice over: one may be lost."""
        self._target(context, 0.0)
        self._target(context, 0.0)


@dataclass(slots=True)
class ConditionYawTurn:
    """Turn by CONDITION_YAW, relative: flying copters and diving subs in GUIDED."""

    rate_radps: float = math.radians(45.0)
    name: str = "CONDITION_YAW"

    def _command(self, context: Context, angle_rad: float) -> Script[MavResult]:
        degrees = math.degrees(angle_rad)
        return (
            yield from command(
                context,
                MavCmd.CONDITION_YAW,
                abs(degrees),
                math.degrees(self.rate_radps),
                math.copysign(1.0, degrees),
                1.0,
                what="CONDITION_YAW",
            )
        )

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Command the whole angle once and wait for the gyro to agree."""
        start_rad = gyro.angle_rad
        sign = math.copysign(1.0, angle_rad)
        if (yield from self._command(context, angle_rad)) != MavResult.ACCEPTED:
            return False
        start_s = context.now
        longest_s = 4.0 + 2.5 * abs(angle_rad) / self.rate_radps
        while context.now - start_s < longest_s:
            yield from pause(context, 0.05)
            turned = (gyro.angle_rad - start_rad) * sign
            if turned >= 0.6 * abs(angle_rad) and abs(gyro.rate_radps) < 0.25 * self.rate_radps:
                return True
            if turned < MOVED_RAD and context.now - start_s > MOVES_WITHIN_S:
                return False
        return (gyro.angle_rad - start_rad) * sign >= MOVED_RAD

    def hold(self, context: Context) -> None:
        """Do nothing: the autopilot holds its own yaw."""

    def halt(self, context: Context) -> None:
        """Command standing still without yaw rate; it takes the place of the yaw command."""
        for _ in range(2):
            context.send(
                mav.SetPositionTargetLocalNed(
                    target_system=context.system,
                    target_component=context.component,
                    coordinate_frame=MavFrame.BODY_OFFSET_NED,
                    type_mask=STAND_AND_YAW_RATE,
                )
            )


def strategies_for(kind: str, autopilot: str, ackermann: bool = False) -> tuple[TurnStrategy, ...]:
    """List the ways to turn a vehicle, best first; empty where only a person can turn it."""
    if autopilot != "ardupilot":
        return ()
    if kind in ("rover", "boat"):
        if ackermann:
            return (
                YawRateTurn(
                    type_mask=STAND_AND_YAW_RATE,
                    rate_radps=math.radians(25.0),
                    forward_mps=1.0,
                    name="slow arcs",
                ),
            )
        return (YawRateTurn(),)
    if kind in ("copter", "sub"):
        return (
            ConditionYawTurn(),
            YawRateTurn(
                type_mask=STAND_AND_YAW_RATE,
                rate_radps=math.radians(45.0),
                name="yaw rate targets at a standstill",
            ),
        )
    return ()
