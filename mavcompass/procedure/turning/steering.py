"""How ArduPilot is asked to turn: one small class per message that does it.

Each is a `Steer`: `turn` asks for a rate of turn and is repeated several times a second, `stand` asks
for none, `let_go` ends what was asked for. Those that name an angle a little ahead of the vehicle
(`HeadingAhead`, `YawStep`) end by themselves soon after the last message: a link that dies in the
middle of a turn leaves no vehicle spinning until its own time-out of three seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame
from mavcompass.procedure.script import Context

# type_mask of SET_POSITION_TARGET_LOCAL_NED: what is to be ignored.
_IGNORE_POSITION = 0x007
_IGNORE_VELOCITY = 0x038
_IGNORE_ACCELERATION = 0x1C0
_IGNORE_YAW = 0x400
_IGNORE_YAW_RATE = 0x800
YAW_ONLY = _IGNORE_POSITION | _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
YAW_RATE_ONLY = _IGNORE_POSITION | _IGNORE_VELOCITY | _IGNORE_ACCELERATION | _IGNORE_YAW
STAND_AND_YAW_RATE = _IGNORE_POSITION | _IGNORE_ACCELERATION | _IGNORE_YAW
# type_mask of SET_ATTITUDE_TARGET: only the yaw rate and the thrust count.
ATTITUDE_YAW_RATE_ONLY = 0x83

_CENTRE_PWM, _SPAN_PWM = 1500, 500
_RELEASE, _UNTOUCHED = 0, 65535
# A full stick's rate of turn differs from vehicle to vehicle; the gyro closes the loop all the same.
_FULL_STICK_RADPS = math.radians(90.0)


class Steer(Protocol):
    """Ask a vehicle to turn by one kind of message."""

    @property
    def name(self) -> str:
        """Return what the person is told."""
        ...

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for a rate of turn, clockwise positive; `left_rad` is what is left of the whole turn."""
        ...

    def stand(self, context: Context) -> None:
        """Ask for no turn at all."""
        ...

    def let_go(self, context: Context) -> None:
        """End what was asked for; called once, after the last `stand`."""
        ...


def _position_target(
    context: Context,
    type_mask: int,
    frame: MavFrame = MavFrame.BODY_NED,
    yaw_rad: float = 0.0,
    yaw_rate_radps: float = 0.0,
    forward_mps: float = 0.0,
) -> None:
    context.send(
        mav.SetPositionTargetLocalNed(
            target_system=context.system,
            target_component=context.component,
            coordinate_frame=frame,
            type_mask=type_mask,
            vx=forward_mps,
            yaw=yaw_rad,
            yaw_rate=yaw_rate_radps,
        )
    )


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
        _position_target(context, YAW_ONLY, MavFrame.BODY_OFFSET_NED, yaw_rad=ahead)

    def stand(self, context: Context) -> None:
        """Ask for no rate: no heading is held, so a yaw that the bad compass bends is not hunted after."""
        _position_target(context, YAW_RATE_ONLY)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


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
        _position_target(
            context, self.type_mask, frame, yaw_rate_radps=rate_radps, forward_mps=self.forward_mps
        )

    def stand(self, context: Context) -> None:
        """Ask for no rate and no speed."""
        _position_target(context, self.type_mask)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


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
                type_mask=ATTITUDE_YAW_RATE_ONLY,
                body_yaw_rate=rate_radps,
            )
        )

    def stand(self, context: Context) -> None:
        """Ask for no rate."""
        self.turn(context, 0.0, 0.0)

    def let_go(self, context: Context) -> None:
        """Do nothing: the target ends by itself."""


@dataclass(frozen=True, slots=True)
class YawStep:
    """Turn on by CONDITION_YAW in small relative steps: flying copters and diving subs in GUIDED.

    A repeated relative command starts from the present yaw, so the steps do not add up.
    """

    step_rad: float = math.radians(8.0)
    name: str = "CONDITION_YAW"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Turn on by a step, at the rate; not farther than what is left."""
        self._command(context, min(self.step_rad, max(left_rad, 0.0)), rate_radps)

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


@dataclass(frozen=True, slots=True)
class SteeringOverride:
    """Move the steering channel by RC_CHANNELS_OVERRIDE, in MANUAL; only where a person asked for it.

    ArduPilot listens to the ground station whose system id is SYSID_MYGCS, and no other.
    """

    channel: int = 1
    name: str = "the steering channel"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Hold the channel to the side."""
        share = max(-1.0, min(1.0, rate_radps / _FULL_STICK_RADPS))
        self._override(context, _CENTRE_PWM + round(share * _SPAN_PWM))

    def stand(self, context: Context) -> None:
        """Hold the channel in the middle."""
        self._override(context, _CENTRE_PWM)

    def let_go(self, context: Context) -> None:
        """Give the channel back to the pilot."""
        self._override(context, _RELEASE)

    def _override(self, context: Context, pwm: int) -> None:
        channels = [_UNTOUCHED] * 8
        channels[self.channel - 1] = pwm
        context.send(mav.RcChannelsOverride(context.system, context.component, *channels))


@dataclass(frozen=True, slots=True)
class ManualAxis:
    """Move the steering by MANUAL_CONTROL, in MANUAL; only where a person asked for it.

    Attributes:
        axis: "y" steers rovers and boats, "r" yaws subs.
        middle: of the throttle axis z: 0 for rovers, 500 for subs, whose thrust goes both ways.
    """

    axis: str = "y"
    middle: int = 0
    name: str = "MANUAL_CONTROL"

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Hold the axis to the side."""
        share = max(-1.0, min(1.0, rate_radps / _FULL_STICK_RADPS))
        self._move(context, round(1000.0 * share))

    def stand(self, context: Context) -> None:
        """Hold the axis in the middle."""
        self._move(context, 0)

    def let_go(self, context: Context) -> None:
        """Do nothing: what is no longer sent is forgotten."""

    def _move(self, context: Context, value: int) -> None:
        y, r = (value, 0) if self.axis == "y" else (0, value)
        context.send(mav.ManualControl(context.system, y=y, z=self.middle, r=r))
