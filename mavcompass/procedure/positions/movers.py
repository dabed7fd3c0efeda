"""Who turns the vehicle to its next position: itself, or a person who is told how.

A vehicle that turns itself does so by the first of its ways to turn that moves it. A person is told, live,
how far to turn, when to level it and when to hold still. Positions may come in any order and from either
side; the gyro counts the turn, so no compass and no marks on the ground are needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from mavcompass.errors import LinkLost, PoorCalibration, Refused
from mavcompass.frames import wrap_pi
from mavcompass.procedure.positions.visiting import DwellSettings, Mover
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import SteeredTurn

# So close to a wanted heading it need not be turned further; a position counts when it is so far from every
# one before it; tilted further, it is to be levelled.
_NEAR_RAD, _APART_RAD, _LEVEL_RAD = math.radians(12.0), math.radians(50.0), math.radians(10.0)
# A person may take so long for one position; held still and tilted for so long, it stands on a slope.
_PATIENCE_S, _SLOPE_PATIENCE_S = 180.0, 15.0
_CLEARLY_RAD = math.radians(10.0)  # so much nearer the other way is worth a change of mind
_POLL_S = 0.1
# A prompt that changes faster than this cannot be read.
_READABLE_S = 0.4
# What has been silent for so long may not hear us, either.
_UNHEARD_S = 0.5
# Telemetry that is silent for this long leaves the person without a guide.
_SILENCE_S = 5.0
# More than a vehicle swings back that was held; and why.
_WRONG_WAY_RAD = math.radians(10.0)
_WRONG_WAY = (
    "With its heading more than 90 deg off, an autopilot steers what has way on as if it went backwards."
    " Turn it by hand (--motion hand) or by the pilot's controls (--turn-by rc-override)."
)


@dataclass(slots=True)
class HandMover(Mover):
    """Prompt a person who turns the vehicle; `visited_rad` are the gyro's angles of the positions so far."""

    visited_rad: list[float] = field(default_factory=list)
    _said: str = ""
    _said_s: float = -math.inf

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Prompt until the vehicle is near a heading that is still wanted, or rests anywhere new.

        Raises PoorCalibration when it is not within the patience, LinkLost where telemetry ends.
        """
        if not self.visited_rad:
            self.visited_rad.append(self.gyro.angle_rad)
        began_rad, began_s = self.gyro.angle_rad, context.now
        while context.now < began_s + _PATIENCE_S:
            self._need_telemetry(context, began_s)
            left_rad = self._left(angle_rad)
            if abs(left_rad) <= _NEAR_RAD:
                context.show("turn", "Here.", cue=1.0)
                return
            if self._is_new(self.gyro.angle_rad, angle_rad) and self.rest.for_s() > 1.5:
                return
            side, degrees = "right" if left_rad > 0.0 else "left", abs(math.degrees(left_rad))
            turned_deg = math.degrees(self.gyro.angle_rad - began_rad)
            text = f"Turn {side} {degrees:.0f} deg more."
            left_deg = math.degrees(left_rad)
            self._prompt(context, text, turned_deg=turned_deg, remaining=float(remaining), left_deg=left_deg)
            yield from pause(context, _POLL_S)
        raise PoorCalibration(
            f"The vehicle was not turned to a new position within {_PATIENCE_S:.0f} s.",
            "Start again and turn it by about 90 degrees when asked.",
        )

    def settle(self, context: Context, settings: DwellSettings) -> Script[bool]:
        """Prompt until the vehicle is level and rests.

        Raises PoorCalibration when it does not within the patience, LinkLost where telemetry ends.
        """
        began_s = context.now
        while context.now < began_s + _PATIENCE_S:
            self._need_telemetry(context, began_s)
            tilt_rad, still_s = self.gyro.tilt_rad, self.rest.for_s()
            level = tilt_rad <= _LEVEL_RAD
            if still_s >= settings.settle_s and (level or still_s > _SLOPE_PATIENCE_S):
                return True
            if level:
                self._prompt(context, f"Hold still {settings.dwell_s:.0f} s.")
            else:
                self._prompt(context, f"Tilted by {math.degrees(tilt_rad):.0f} deg: level it.", level=1.0)
            yield from pause(context, _POLL_S)
        raise PoorCalibration(
            f"The vehicle was not held still within {_PATIENCE_S:.0f} s ({self.rest.why_not or 'tilted'}).",
            "Put it down, or rest it against something, and start again.",
        )

    def hold(self, context: Context, left_s: float) -> None:
        """Count the dwell down."""
        self._prompt(context, f"Hold still {max(math.ceil(left_s - 0.2), 1)} s.")

    def accept(self, context: Context, turned_rad: float) -> bool:
        """Take a position; False for one that is where an earlier one was."""
        if any(self._apart(turned_rad, seen) < _APART_RAD for seen in self.visited_rad):
            context.show("turn", "The vehicle stood here before: turn it further.", cue=1.0)
            return False
        self.visited_rad.append(turned_rad)
        context.show("taken", f"Position {len(self.visited_rad)} is taken.", cue=1.0)
        return True

    # --- which way ----------------------------------------------------------------------------------

    def _left(self, step_rad: float) -> float:
        """Return the turn to the nearest heading that is wanted; of two as near, the one asked for."""
        now_rad = self.gyro.angle_rad
        turns = [float(wrap_pi(heading - now_rad)) for heading in self._wanted(step_rad)]
        return min(turns, key=lambda turn: abs(turn) - (_CLEARLY_RAD if turn * step_rad > 0.0 else 0.0))

    def _wanted(self, step_rad: float) -> list[float]:
        """List the headings that are still wanted: the steps of the circle, or either side of the last."""
        first, last = self.visited_rad[0], self.visited_rad[-1]
        steps = (first + k * step_rad for k in range(1, round(2.0 * math.pi / abs(step_rad))))
        free = [step for step in steps if self._is_apart(step, step_rad, self.visited_rad)]
        return free or [last + step_rad, last - step_rad]

    def _is_new(self, angle_rad: float, step_rad: float) -> bool:
        """Tell whether a heading is far from every position so far; from the last, once all are taken."""
        full = len(self.visited_rad) * abs(step_rad) >= 2.0 * math.pi - 1e-6
        before = self.visited_rad[-1:] if full else self.visited_rad
        return self._is_apart(angle_rad, step_rad, before)

    def _is_apart(self, angle_rad: float, step_rad: float, before: Sequence[float]) -> bool:
        apart_rad = min(_APART_RAD, 0.6 * abs(step_rad))
        return all(self._apart(angle_rad, seen) >= apart_rad for seen in before)

    @staticmethod
    def _apart(a_rad: float, b_rad: float) -> float:
        return abs(float(wrap_pi(a_rad - b_rad)))

    # --- what is said -------------------------------------------------------------------------------

    def _prompt(self, context: Context, text: str, **data: float) -> None:
        """Tell the person what to do, not faster than can be read."""
        if text != self._said and context.now - self._said_s >= _READABLE_S:
            context.show("turn", text, live=1.0, **data)
            self._said, self._said_s = text, context.now

    def _need_telemetry(self, context: Context, began_s: float) -> None:
        if context.now - max(self.rest.heard_s, began_s) > _SILENCE_S:
            raise LinkLost(
                f"No RAW_IMU or SCALED_IMU message came for {_SILENCE_S:.0f} s.",
                "Check that the vehicle streams them on this link (SRn_RAW_SENS, MAV_n_MODE).",
            )


@dataclass(slots=True)
class VehicleMover(Mover):
    """Let the vehicle turn itself; a strategy that does not move it is replaced by the next."""

    by_itself: ClassVar[bool] = True
    strategies: Sequence[SteeredTurn] = ()
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
                then = self.strategies[self._current].way.name
                context.show("turn", f"{strategy.way.name} did not move the vehicle; trying {then}.")
        raise Refused(
            "The vehicle accepted the commands but the gyro saw no turn.",
            "Put it into GUIDED, armed (a copter: flying), or turn it by hand with --motion hand.",
        )

    def hold(self, context: Context, left_s: float) -> None:
        """Hold by the strategy in use."""
        if self._used and self._current < len(self.strategies):
            self.strategies[self._current].hold(context)

    def halt(self, context: Context) -> None:
        """Halt by every strategy that was used; once, until the next turn, where the vehicle can hear it."""
        if self._moving:
            self._moving = context.now - context.heard_s > _UNHEARD_S
            for strategy in self._all_used():
                strategy.halt(context)

    def release(self, context: Context) -> Script[None]:
        """Release by every strategy that was used."""
        for strategy in self._all_used():
            yield from strategy.release(context)

    def _all_used(self) -> Sequence[SteeredTurn]:
        return self.strategies[: self._current + 1] if self._used else ()
