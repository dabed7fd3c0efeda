"""How a flight controller turns a vehicle: sticks, targets on the ground, auto-yaw in air and water.

Everything is closed on the filter's yaw, the only one a flight controller has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

from mavcompass.frames import wrap_angle
from mavcompass.messages import ManualControl, RcChannelsOverride
from mavcompass.simulation.autopilot.board import Board
from mavcompass.simulation.physics.motion import Drive

# A target, and what stands in for the pilot's sticks, is forgotten after so long.
TARGET_TIMEOUT_S = OVERRIDE_TIMEOUT_S = 3.0
_STICK_CENTRE, _STICK_SPAN, _STICK_DEADZONE = 1500, 500, 30
_STICK_LOW, _SWITCH_HIGH = 1000, 1800
_IGNORE, _RELEASE = 65535, 0
_UNUSED_AXIS, _FULL_AXIS = 32767, 1000
_TWO_PI = 2.0 * math.pi
_LANDED_AND_IDLE_S = 2.0


class Ignore(IntFlag):
    """Name the bits of SET_POSITION_TARGET's type_mask."""

    POSITION = 0x007
    VELOCITY = 0x038
    ACCELERATION = 0x1C0
    YAW = 0x400
    YAW_RATE = 0x800


@dataclass(frozen=True, slots=True)
class Target:
    """Hold what a ground station wants: a heading or a turn rate, and a speed."""

    time_s: float
    heading_rad: float | None = None
    rate_radps: float | None = None
    speed_mps: float = 0.0


def stick(pwm: int) -> float:
    """Turn a pulse width into -1..1, zero around the centre."""
    offset = pwm - _STICK_CENTRE
    if abs(offset) <= _STICK_DEADZONE:
        return 0.0
    return max(-1.0, min(1.0, offset / _STICK_SPAN))


class Radio:
    """Hold the pulse widths of eight channels: roll or steering, pitch, throttle, yaw, switches.

    `throttle_low`: the stick rests at the bottom. `hovers`: MANUAL_CONTROL's thrust goes from 0 to 1000.
    """

    def __init__(self, throttle_low: bool, hovers: bool) -> None:
        self._hovers = hovers
        low, middle, high = _STICK_LOW, _STICK_CENTRE, _SWITCH_HIGH
        throttle = low if throttle_low else middle
        self._rest = (middle, middle, throttle, middle, high, low, low, high)
        self._held: dict[int, tuple[int, float]] = {}
        self._overrides: dict[int, tuple[int, float]] = {}

    def channel(self, number: int, now_s: float) -> int:
        """Return a channel's pulse width: the pilot's hand, then an override, then the rest position."""
        for source in (self._held, self._overrides):
            if number in source:
                pwm, until_s = source[number]
                if now_s <= until_s:
                    return pwm
                del source[number]
        return self._rest[number - 1]

    def channels(self, now_s: float) -> tuple[int, ...]:
        """Return all channels."""
        return tuple(self.channel(n, now_s) for n in range(1, len(self._rest) + 1))

    def hold(self, channel: int, pwm: int, until_s: float) -> None:
        """Let the pilot hold a channel."""
        self._held[channel] = (pwm, until_s)

    def override(self, message: RcChannelsOverride | ManualControl, now_s: float) -> None:
        """Take a ground station's values; they are forgotten after three seconds."""
        until_s = now_s + OVERRIDE_TIMEOUT_S
        if isinstance(message, ManualControl):
            thrust = 2 * message.z - _FULL_AXIS if self._hovers else message.z
            axes = {1: message.y, 2: -message.x, 3: thrust, 4: message.r}
            for number, value in axes.items():
                if abs(value) < _UNUSED_AXIS:
                    deflection = max(-_FULL_AXIS, min(value, _FULL_AXIS))
                    self._overrides[number] = (_STICK_CENTRE + deflection // 2, until_s)
            return
        for number in range(1, 9):
            pwm = getattr(message, f"chan{number}_raw")
            if pwm == _RELEASE:
                self._overrides.pop(number, None)
            elif pwm != _IGNORE:
                self._overrides[number] = (pwm, until_s)


class GroundGuidance:
    """Steer rovers and boats."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._target: Target | None = None
        self._rate_radps = 0.0

    def set_target(self, target: Target) -> None:
        """Take a new target; it lasts three seconds."""
        self._target = target

    def stop(self) -> None:
        """Forget the target, as a change of mode does."""
        self._target = None
        self._rate_radps = 0.0

    def expire(self) -> bool:
        """Drop a target that is too old; True at the moment it happens."""
        if self._target is None or self._board.boot_time_s - self._target.time_s <= TARGET_TIMEOUT_S:
            return False
        self.stop()
        return True

    def guided(self, dt_s: float, gain_per_s: float, rate_max: float, acceleration: float) -> Drive:
        """Follow the target: P on the heading error, limited in rate and acceleration."""
        target = self._target
        if target is None:
            return Drive()
        if target.rate_radps is not None:
            wanted = target.rate_radps
        else:
            wanted = gain_per_s * wrap_angle((target.heading_rad or 0.0) - self._board.filter.yaw_rad)
        wanted = max(-rate_max, min(rate_max, wanted))
        most = acceleration * dt_s
        self._rate_radps = max(self._rate_radps - most, min(self._rate_radps + most, wanted))
        return Drive(self._rate_radps, target.speed_mps, motors_on=True)

    def by_hand(self, steering_pwm: int, throttle_pwm: int) -> Drive:
        """Follow the sticks."""
        p = self._board.profile
        steering, throttle = stick(steering_pwm), stick(throttle_pwm)
        if not steering and not throttle:
            return Drive()
        turn = steering * 0.6 * p.yaw_rate_max_radps
        return Drive(turn, throttle * p.speed_max_mps, motors_on=True)


class HoverGuidance:
    """Hold and turn what hovers: the yaw target moves at a slew rate, the vehicle follows it."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self.height_m: float | None = None
        self._yaw_rad: float | None = None
        self._left_rad = 0.0
        self._slew_radps = 0.0
        self._target: Target | None = None
        self._idle_s = 0.0

    def hold(self) -> None:
        """Hold the present heading."""
        self._yaw_rad = self._board.filter.yaw_rad
        self._left_rad = 0.0
        self._target = None

    def hold_here(self) -> None:
        """Hold the present heading and height."""
        self.hold()
        self.height_m = self._board.body.height_m

    def release(self) -> None:
        """Let go: on the ground, or disarmed."""
        self._yaw_rad = None
        self._left_rad = 0.0
        self._target = None

    def idle(self, dt_s: float, mode: str, patience_s: float) -> bool:
        """Stand on the ground with the motors idling; tell whether it is time to disarm."""
        self.release()
        self.height_m = None
        self._idle_s += dt_s
        if self._idle_s < (_LANDED_AND_IDLE_S if mode in ("LAND", "RTL") else patience_s):
            return False
        self._idle_s = 0.0
        return True

    def turn(self, angle_rad: float, slew_radps: float, direction: int, relative: bool) -> None:
        """Turn as CONDITION_YAW says: to or by an angle, from the present heading."""
        start = self._board.filter.yaw_rad
        if relative:
            by = angle_rad if direction >= 0 else -angle_rad
        else:
            by = wrap_angle(angle_rad - start)
            if direction < 0 < by:
                by -= _TWO_PI
            elif direction > 0 > by:
                by += _TWO_PI
        self._yaw_rad, self._left_rad, self._slew_radps = start, by, slew_radps
        self._target = None

    def set_target(self, target: Target, slew_radps: float) -> None:
        """Take a velocity target with a heading or a turn rate."""
        if target.heading_rad is not None:
            by = wrap_angle(target.heading_rad - self._board.filter.yaw_rad)
            if self._target is None or self._target.heading_rad != target.heading_rad:
                self._yaw_rad = self._board.filter.yaw_rad
                self._left_rad, self._slew_radps = by, slew_radps
        else:
            self._left_rad = 0.0
        self._target = target

    def yaw_rate(self, dt_s: float, turn_by_hand_radps: float = 0.0) -> float | None:
        """Return the turn rate to fly now; None to let go."""
        self._idle_s = 0.0
        if self._yaw_rad is None:
            return None
        feed = turn_by_hand_radps
        target = self._target
        if target is not None:
            if self._board.boot_time_s - target.time_s > TARGET_TIMEOUT_S:
                self._target = target = None
            elif target.rate_radps is not None:
                feed = target.rate_radps
        if self._left_rad:
            step = math.copysign(min(abs(self._left_rad), self._slew_radps * dt_s), self._left_rad)
            self._left_rad -= step
            self._yaw_rad = wrap_angle(self._yaw_rad + step)
            feed = step / dt_s
        elif feed:
            self._yaw_rad = wrap_angle(self._yaw_rad + feed * dt_s)
        error = wrap_angle(self._yaw_rad - self._board.filter.yaw_rad)
        return feed + self._board.profile.yaw_gain_per_s * error

    @property
    def speed_mps(self) -> float:
        """Return the forward speed of the target."""
        return self._target.speed_mps if self._target else 0.0

    def climb_rate(self, up_mps: float, down_mps: float) -> float:
        """Return the climb rate towards the height to hold."""
        if self.height_m is None:
            return 0.0
        error = self.height_m - self._board.body.height_m
        return max(-down_mps, min(up_mps, 1.0 * error))
