"""A vehicle that turns itself, by the first of its ways to turn that moves it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from mavcompass.errors import Refused
from mavcompass.procedure.positions.visiting import Mover
from mavcompass.procedure.script import Context, Script
from mavcompass.procedure.turning import GyroAngle, TurnStrategy

# More than a vehicle swings back that was held; and why.
_WRONG_WAY_RAD = math.radians(10.0)
_WRONG_WAY = (
    "With its heading more than 90 deg off, an autopilot steers what has way on as if it went backwards."
    " Turn it by hand (--motion hand) or by the pilot's controls (--turn-by rc-override)."
)


@dataclass(slots=True)
class VehicleMover(Mover):
    """Let the vehicle turn itself; a strategy that does not move it is replaced by the next."""

    gyro: GyroAngle
    by_itself: ClassVar[bool] = True
    strategies: Sequence[TurnStrategy]
    _current: int = 0
    _used: bool = False
    _moving: bool = False

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Turn by the current strategy, or by the next that moves the vehicle.

        Raises Refused when none does, or it turns the wrong way round, as then none will turn it.
        """
        self._used = self._moving = True
        while self._current < len(self.strategies):
            strategy, began_rad = self.strategies[self._current], self.gyro.angle_rad
            if (yield from strategy.turn(context, self.gyro, angle_rad)):
                return
            back_rad = math.copysign(1.0, angle_rad) * (began_rad - self.gyro.angle_rad)
            if back_rad > _WRONG_WAY_RAD:
                raise Refused(f"It turned {math.degrees(back_rad):.0f} deg the wrong way round.", _WRONG_WAY)
            self._current += 1
            if self._current < len(self.strategies):
                then = self.strategies[self._current].name
                context.show("turn", f"{strategy.name} did not move the vehicle; trying {then}.")
        raise Refused(
            "The vehicle accepted the commands but the gyro saw no turn.",
            "Put it into GUIDED, armed (a copter: flying), or turn it by hand with --motion hand.",
        )

    def hold(self, context: Context, left_s: float) -> None:
        """Hold by the strategy in use."""
        if self._used and self._current < len(self.strategies):
            self.strategies[self._current].hold(context)

    def halt(self, context: Context) -> None:
        """Halt by every strategy that was used; once, until the next turn."""
        if self._moving:
            self._moving = False
            for strategy in self._all_used():
                strategy.halt(context)

    def release(self, context: Context) -> Script[None]:
        """Release by every strategy that was used."""
        for strategy in self._all_used():
            yield from strategy.release(context)

    def _all_used(self) -> Sequence[TurnStrategy]:
        return self.strategies[: self._current + 1] if self._used else ()
