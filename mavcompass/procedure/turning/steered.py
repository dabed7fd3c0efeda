"""A turn by repeated commands, closed on the gyro, whichever message commands it.

A `Steer` commands; the gyro tells whether and how far the vehicle turned. An acknowledgement
proves nothing: ArduCopter accepts CONDITION_YAW in every mode and moves only in some.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning.gyro_angle import GyroAngle

# How often a target is repeated: several in the time in which one that ends by itself ends.
_REPEAT_S = 0.1
_POLL_S = 0.05
_MOVES_WITHIN_S = 3.0
_MOVED_RAD = math.radians(6.0)
# How long a vehicle takes to gather way, and how its rate is then brought to what was asked for.
_GATHERS_WAY_S = 0.5
# A command, and what the gyro tells of it, come so late.
_LATE_S = 0.1
_SLOWEST_RADPS = math.radians(15.0)  # at which a turn ends
_BOOST_GAIN, _MOST_BOOST = 0.15, 1.6
# Events come at least this often; a longer step is our own computer's, which solved or slept meanwhile.
_LONGEST_STEP_S = 0.2
# Below it, what was to turn stands.
SLOW_RADPS = math.radians(5.0)
# So long a body runs on when its target is reached; one bent by a bad compass creeps (fault matrix: 0.14 s).
RUNS_ON_S = 0.15
# What holds an angle and is stopped dead swings back: it turns on for so long, per rate, at half of it.
_LAST_S = 0.1


@dataclass(frozen=True, slots=True)
class TurnWay:
    """Hold one way to turn a vehicle.

    Attributes:
        name: as a person is told; a file of `ways/` knows the message behind it.
        rate_radps: of the turn. slow_down_s: the rate is at most what is left divided by this.
        coast_s: angle coasted after the last command, per rate at that moment.
        gain_per_s: rate of turn per radian of heading error, for ways that name a heading.
        forward_mps: speed while turning, for what cannot turn on the spot.
        speed_up_s: the rate grows to its full size in so long: a step sets a soft vehicle swinging.
        ends_within_s: the vehicle stands so soon after the last heading that it was told, its link dead.
        round_radps, round_ends_within_s: the same of one turn all the way round without a stop; 0 where
            that is not possible.
    """

    name: str
    rate_radps: float
    slow_down_s: float = 0.6
    coast_s: float = 0.3
    gain_per_s: float = 2.0
    forward_mps: float = 0.0
    speed_up_s: float = 0.0
    ends_within_s: float = 1.0
    round_radps: float = 0.0
    round_ends_within_s: float = 1.0

    def all_round(self) -> TurnWay:
        """Return the same way at the rate of a turn without a stop."""
        return replace(self, rate_radps=self.round_radps, ends_within_s=self.round_ends_within_s)


class Steer(ABC):
    """Ask a vehicle to turn by one kind of message."""

    __slots__ = ()

    @abstractmethod
    def turn(self, context: Context, rate_radps: float, left_rad: float) -> None:
        """Ask for a rate of turn, clockwise positive; `left_rad` is what is left of the whole turn."""

    @abstractmethod
    def stand(self, context: Context) -> None:
        """Ask for no turn at all."""

    def let_go(self, context: Context) -> None:  # noqa: B027 (most have nothing to end)
        """End what was asked for, where it does not end by itself; called after the last `stand`."""


@dataclass(slots=True)
class SteeredTurn:
    """Turn by an angle measured by the gyro, by repeated commands at the rates of a vehicle's profile.

    The rate falls toward the end, so that late telemetry costs degrees, not quarter turns. How far the
    vehicle coasts after the last command is learned from one turn to the next.

    Attributes:
        steer: the message that turns it.
        arrives: the commands name angles, and the vehicle comes to rest there by itself.
    """

    steer: Steer
    way: TurnWay
    arrives: bool = False
    _asked_radps: float = 0.0
    _learned_s: float | None = None
    _ended: tuple[float, float] | None = None

    def turn(self, context: Context, gyro: GyroAngle, angle_rad: float) -> Script[bool]:
        """Command the rate (clockwise positive) until the gyro says that the rest is what stopping takes.

        False where the vehicle does not move.
        """
        self._learn_coasting(gyro)
        start_rad, looked_s, so_far_s = gyro.angle_rad, context.now, 0.0
        sign = math.copysign(1.0, angle_rad)
        longest_s = _MOVES_WITHIN_S + 3.0 * abs(angle_rad) / _SLOWEST_RADPS
        said_s, boost, most = -math.inf, 1.0, self._most_radps(abs(angle_rad))
        while True:
            so_far_s += min(context.now - looked_s, _LONGEST_STEP_S)
            looked_s = context.now
            turned = (gyro.angle_rad - start_rad) * sign
            left, speed = abs(angle_rad) - turned, gyro.rate_radps * sign
            if so_far_s > _MOVES_WITHIN_S and turned < _MOVED_RAD:
                self.halt(context)
                return False
            if self._is_there(left, speed, turned) or so_far_s > longest_s:
                break
            if context.now - said_s >= _REPEAT_S - 1e-3:
                fastest = most * self._gathered(so_far_s + _REPEAT_S)
                wanted = min(fastest, max(_SLOWEST_RADPS, left / self.way.slow_down_s))
                boost = self._boosted(boost, wanted, speed, so_far_s)
                self._asked_radps = sign * wanted * boost
                self.steer.turn(context, self._asked_radps, left)
                said_s = context.now
            yield from pause(context, _POLL_S)
        self._ended = None if self.arrives else (gyro.angle_rad, gyro.rate_radps)
        self._asked_radps = 0.0
        self._stand(context)
        return True

    def _is_there(self, left: float, speed: float, turned: float) -> bool:
        if self.arrives:
            return left < _MOVED_RAD or (turned > 0.6 * (turned + left) and speed < SLOW_RADPS)
        coast_s = self.way.coast_s if self._learned_s is None else self._learned_s
        return left <= max(speed, 0.0) * coast_s

    def _most_radps(self, angle_rad: float) -> float:
        """Return the rate that a turn grows to: of a short one, as much as it can slow down from in time."""
        way = self.way
        return min(way.rate_radps, angle_rad / (0.5 * way.speed_up_s + way.slow_down_s + _LATE_S))

    def _gathered(self, so_far_s: float) -> float:
        """Return the share of the rate that is asked for so long after the beginning."""
        return min(1.0, so_far_s / self.way.speed_up_s) if self.way.speed_up_s else 1.0

    def _boosted(self, boost: float, wanted: float, speed: float, so_far_s: float) -> float:
        """Ask for more where the vehicle turns more slowly than it is asked to."""
        if self.arrives or so_far_s < _GATHERS_WAY_S or wanted < self.way.rate_radps:
            return boost
        return max(1.0, min(_MOST_BOOST, boost + _BOOST_GAIN * (wanted - speed) / wanted))

    def _learn_coasting(self, gyro: GyroAngle) -> None:
        """Compare where the vehicle came to rest with where the last turn's commands ended."""
        if self._ended is not None and abs(self._ended[1]) > SLOW_RADPS:
            coasted_s = (gyro.angle_rad - self._ended[0]) / self._ended[1]
            self._learned_s = max(0.1, min(2.5, coasted_s))
        self._ended = None

    def _stand(self, context: Context) -> None:
        # Twice over: one may be lost.
        for _ in range(2):
            self.steer.stand(context)

    def hold(self, context: Context) -> None:
        """Ask for no turn; called several times a second."""
        self.steer.stand(context)

    def halt(self, context: Context) -> None:
        """Ask for no turn, and let go."""
        self._stand(context)
        for _ in range(2):
            if self.arrives and self._asked_radps:
                self.steer.turn(context, 0.5 * self._asked_radps, _LAST_S * abs(self._asked_radps))
            else:
                self.steer.let_go(context)
        self._asked_radps = 0.0

    def release(self, context: Context) -> Script[None]:
        """Give the vehicle back as it was taken, after `halt`: nothing was, but what that gives back."""
        yield from ()


# Builds a turn from the numbers of a profile; the modes are for one that needs a mode of its own.
Builder = Callable[[TurnWay, ModeKeeper | None], SteeredTurn]
