"""Turn a vehicle in GUIDED: by headings, by yaw rates, by steps of CONDITION_YAW; a target ends by itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavFrame
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import RUNS_ON_S, SLOW_RADPS, Builder, Steer, SteeredTurn
from mavcompass.procedure.turning.targets import STAND_AND_YAW_RATE, YAW_ONLY, YAW_RATE_ONLY, send_target
from mavcompass.procedure.vehicle_state import VehicleState

# Far from half a turn, beyond which it would be the other way round.
_FARTHEST_RAD = math.radians(90.0)
# So long ago, at most, the heading was true that the autopilot told last: at 10 Hz, over a link.
_TOLD_LATE_S = 0.3
# CONDITION_YAW's own words, the step by which it is repeated, and the rate at which what is left is gone.
_STEP_RAD, _RELATIVE, _ABSOLUTE, _SHORTER, _LET_GO_DEG_S = math.radians(8.0), 1.0, 0.0, 0.0, 30.0
# SET_ATTITUDE_TARGET's type_mask: only the yaw rate and the thrust count.
_RATE_AND_THRUST = 0x83


@dataclass(frozen=True, slots=True)
class HeadingAhead(Steer):
    """Name a heading ahead of the vehicle, again and again: skid-steer rovers and boats in GUIDED.

    What was named last is where a vehicle goes whose link dies, at the rate gain times what is left. So no
    heading is named that is farther ahead than it takes to be slow again in time, however slowly it turns.

    Attributes:
        gain_per_s: rate of turn per radian of heading error, as rovers have it (ATC_STR_ANG_P).
        ends_within_s: the vehicle stands so soon after the last word.
    """

    gain_per_s: float = 2.0
    ends_within_s: float = 1.0

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


@dataclass(frozen=True, slots=True)
class YawRate(Steer):
    """Ask for a yaw rate by SET_POSITION_TARGET_LOCAL_NED.

    Attributes:
        type_mask: what is to be ignored; rovers take a bare yaw rate, copters want a velocity with it.
        forward_mps: speed while turning, for what cannot turn on the spot.
    """

    type_mask: int = YAW_RATE_ONLY
    forward_mps: float = 0.0

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for the rate."""
        # BODY_OFFSET_NED is the frame in which a forward speed is the vehicle's own.
        frame = MavFrame.BODY_OFFSET_NED if self.forward_mps else MavFrame.BODY_NED
        send_target(context, self.type_mask, frame, yaw_rate_radps=rate_radps, forward_mps=self.forward_mps)

    def stand(self, context: Context) -> None:
        """Ask for no rate and no speed."""
        send_target(context, self.type_mask)


@dataclass(frozen=True, slots=True)
class AttitudeRate(Steer):
    """Ask for a yaw rate by SET_ATTITUDE_TARGET without thrust: rovers and boats."""

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for the rate."""
        context.send(
            mav.SetAttitudeTarget(
                target_system=context.system,
                target_component=context.component,
                type_mask=_RATE_AND_THRUST,
                body_yaw_rate=rate_radps,
            )
        )

    def stand(self, context: Context) -> None:
        """Ask for no rate."""
        self.turn(context, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class YawStep(Steer):
    """Turn on by CONDITION_YAW in small relative steps: flying copters and diving subs in GUIDED.

    A repeated relative command replaces what is left of the last one, so the steps do not add up. The last
    one is gone on with where the link dies: it is no longer than the rate covers in time.

    ArduSub adds a relative angle to the heading that it aims at, and turns the way in which the sum lies from
    its own heading (AC_AttitudeControl_Sub). Where that is being put right and the aim lags behind, it turns
    the wrong way round, and goes on. It is told headings.

    Attributes:
        own: knows the autopilot's own heading, by which headings are told; None for relative angles.
    """

    ends_within_s: float = 1.0
    own: VehicleState | None = None

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Turn on by a step, at the rate; not farther than what is left, or than it turns in time."""
        in_time_rad = abs(rate_radps) * (self.ends_within_s - RUNS_ON_S)
        late_rad, step_rad = abs(rate_radps) * _TOLD_LATE_S, min(_STEP_RAD, in_time_rad, max(left_rad, 0.0))
        rate_deg_s, sign = math.degrees(abs(rate_radps)), math.copysign(1.0, rate_radps)
        # What is nearer than the heading is late by is told best by what it aims at.
        if self.own is None or self.own.attitude is None or left_rad <= late_rad:
            context.command(MavCmd.CONDITION_YAW, math.degrees(step_rad), rate_deg_s, sign, _RELATIVE)
        else:
            ahead_rad = min(step_rad + late_rad, in_time_rad, left_rad)
            heading_deg = math.degrees(self.own.attitude.yaw + sign * ahead_rad) % 360.0
            context.command(MavCmd.CONDITION_YAW, heading_deg, rate_deg_s, _SHORTER, _ABSOLUTE)

    def stand(self, context: Context) -> None:
        """Do nothing: the last step ends by itself and the autopilot holds its yaw."""

    def let_go(self, context: Context) -> None:
        """Hold what it aims at."""
        context.command(MavCmd.CONDITION_YAW, 0.0, _LET_GO_DEG_S, 1.0, _RELATIVE)


WAYS: dict[str, Builder] = {
    "heading targets": lambda way, modes: SteeredTurn(HeadingAhead(way.gain_per_s, way.ends_within_s), way),
    "yaw rate targets": lambda way, modes: SteeredTurn(YawRate(), way),
    "yaw rate targets at a standstill": lambda way, modes: SteeredTurn(YawRate(STAND_AND_YAW_RATE), way),
    "slow arcs": lambda way, modes: SteeredTurn(YawRate(STAND_AND_YAW_RATE, way.forward_mps), way),
    "attitude targets": lambda way, modes: SteeredTurn(AttitudeRate(), way),
    "CONDITION_YAW": lambda way, modes: SteeredTurn(YawStep(way.ends_within_s), way, arrives=True),
    "CONDITION_YAW to headings": lambda way, modes: SteeredTurn(
        YawStep(way.ends_within_s, None if modes is None else modes.state), way, arrives=True
    ),
}
