"""Turn by the pilot's own controls, in a mode in which they steer; only where a person asked for it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from mavcompass import messages as mav
from mavcompass.procedure.script import Context
from mavcompass.procedure.turning.steered import Steer, SteeredTurn, TurnWay

TurnBy = Literal["auto", "rc-override", "manual-control"]

_NAMES = {"rc-override": "the steering channel", "manual-control": "MANUAL_CONTROL"}

_CENTRE_PWM, _SPAN_PWM = 1500, 500
_RELEASE, _UNTOUCHED = 0, 65535
# A full stick's rate of turn differs from vehicle to vehicle; the gyro closes the loop all the same.
_FULL_STICK_RADPS = math.radians(90.0)


@dataclass(frozen=True, slots=True)
class SteeringOverride(Steer):
    """Move the steering channel by RC_CHANNELS_OVERRIDE; only where a person asked for it.

    ArduPilot listens to the ground station whose system id is SYSID_MYGCS, and no other.
    """

    channel: int = 1

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
class ManualAxis(Steer):
    """Move the steering by MANUAL_CONTROL; what is no longer sent is forgotten.

    Attributes:
        axis: "y" steers rovers and boats, "r" yaws subs and quadplanes.
        middle: of the throttle axis z: 0 for rovers, 500 for those that it moves up and down.
    """

    axis: str = "y"
    middle: int = 0

    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Hold the axis to the side."""
        share = max(-1.0, min(1.0, rate_radps / _FULL_STICK_RADPS))
        self._move(context, round(1000.0 * share))

    def stand(self, context: Context) -> None:
        """Hold the axis in the middle."""
        self._move(context, 0)

    def _move(self, context: Context, value: int) -> None:
        y, r = (value, 0) if self.axis == "y" else (0, value)
        context.send(mav.ManualControl(context.system, y=y, z=self.middle, r=r))


# The channel by which each kind of vehicle is steered (1) or yawed (4), and so its axis of MANUAL_CONTROL.
_CHANNELS = {"rover": 1, "boat": 1, "sub": 4, "vtol": 4}


def turn_by_controls(kind: str, by: TurnBy) -> SteeredTurn | None:
    """Return the turn by the pilot's controls; None for a kind of vehicle that they do not turn."""
    if by == "auto" or (channel := _CHANNELS.get(kind)) is None:
        return None
    steer: Steer = SteeringOverride(channel)
    if by == "manual-control":
        steer = ManualAxis() if channel == 1 else ManualAxis("r", 500)
    return SteeredTurn(steer, TurnWay(_NAMES[by], math.radians(40.0), coast_s=0.5))


def channels_moved(kind: str, by: TurnBy) -> frozenset[int]:
    """List the RC channels that a turn moves: they say nothing about the pilot."""
    if by == "auto" or kind not in _CHANNELS:
        return frozenset()
    return frozenset({_CHANNELS[kind]} if by == "rc-override" else {1, 2, 3, 4})
