"""Visit the still positions of a calibration: wait for rest, dwell, turn, again.

The vehicle turns itself by a `TurnStrategy`, or a person turns it. Both give the same: stretches of
the recording, in the vehicle's time, in which it stood still.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from mavcompass import messages as mav
from mavcompass.calibration.stillness import StillnessDetector
from mavcompass.errors import LinkLost, PoorCalibration, Refused
from mavcompass.frames import wrap_pi
from mavcompass.procedure.gyro_angle import GyroAngle
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import TurnStrategy
from mavcompass.telemetry import acceleration_mps2, angular_rate_radps, field_mgauss, imu_time_s

_HOLD_EVERY_S = 0.5


@dataclass(frozen=True, slots=True)
class Window:
    """Hold one still stretch: vehicle time, and the gyro's live angle at its end."""

    start_s: float
    end_s: float
    turned_rad: float


@dataclass(frozen=True, slots=True)
class DwellSettings:
    """Hold how long to stand still.

    Attributes:
        dwell_s: length of a dwell; twenty fresh readings of a compass read at 10 Hz.
        settle_s: rest before a dwell begins: the compass's 100 ms average and the chassis settle.
        patience_s: a vehicle that hunts longer than this is dwelt upon as it is; the sway is then in
            the data, where the gyro explains it.
    """

    dwell_s: float = 2.0
    settle_s: float = 0.4
    patience_s: float = 6.0


@dataclass(slots=True)
class Rest:
    """Tell live whether the vehicle stands still; `hear` is a listener."""

    detector: StillnessDetector = field(default_factory=lambda: StillnessDetector(hold_s=0.0))
    time_s: float = -math.inf
    still_since_s: float | None = None
    why_not: str = "nothing was heard yet"

    def hear(self, heard: mav.Incoming) -> None:
        """Take one message; RAW_IMU or SCALED_IMU count."""
        message = heard.message
        if type(message) not in (mav.RawImu, mav.ScaledImu):
            return
        time_s = float(imu_time_s(message))
        if time_s <= self.time_s:
            return
        self.time_s = time_s
        state = self.detector.update(
            time_s, angular_rate_radps(message), acceleration_mps2(message), field_mgauss(message)
        )
        self.still_since_s = None if math.isnan(state.since_s) else state.since_s
        self.why_not = state.why_not

    def for_s(self) -> float:
        """Return for how long it has been still, seconds of the vehicle's time."""
        return 0.0 if self.still_since_s is None else self.time_s - self.still_since_s


class Mover(Protocol):
    """Bring the vehicle to its next position."""

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Turn by about `angle_rad`; the gyro's angle tells what came of it."""
        ...

    def hold(self, context: Context) -> None:
        """Keep it there; called twice a second during a dwell."""
        ...

    def halt(self, context: Context) -> None:
        """Stop any motion now."""
        ...


@dataclass(slots=True)
class VehicleMover:
    """Let the vehicle turn itself; a strategy that does not move it is replaced by the next."""

    gyro: GyroAngle
    strategies: Sequence[TurnStrategy]
    _current: int = 0

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Turn by the current strategy, or by the next that moves the vehicle.

        Raises Refused when none does.
        """
        while self._current < len(self.strategies):
            strategy = self.strategies[self._current]
            if (yield from strategy.turn(context, self.gyro, angle_rad)):
                return
            self._current += 1
            if self._current < len(self.strategies):
                then = self.strategies[self._current].name
                context.show("turn", f"{strategy.name} did not move the vehicle; trying {then}.")
        raise Refused(
            "The vehicle accepted the commands but the gyro saw no turn.",
            "Put it into GUIDED, armed (a copter: flying), or turn it by hand with --motion hand.",
        )

    def hold(self, context: Context) -> None:
        """Hold by the strategy in use."""
        if self._current < len(self.strategies):
            self.strategies[self._current].hold(context)

    def halt(self, context: Context) -> None:
        """Halt by every strategy that was used."""
        for strategy in self.strategies[: self._current + 1]:
            strategy.halt(context)


@dataclass(slots=True)
class HandMover:
    """Prompt a person who turns the vehicle; any order, either direction.

    A position counts when the vehicle rests at least `apart_rad` from every one before it.
    """

    gyro: GyroAngle
    rest: Rest
    apart_rad: float = math.radians(50.0)
    patience_s: float = 180.0
    visited_rad: list[float] = field(default_factory=list)

    def next(self, context: Context, angle_rad: float, remaining: int) -> Script[None]:
        """Prompt until the vehicle rests somewhere new.

        Raises PoorCalibration when it does not within the patience.
        """
        here = self.gyro.angle_rad
        self.visited_rad.append(here)
        end = context.now + self.patience_s
        said, said_s = "", -math.inf
        while context.now < end:
            yield from pause(context, 0.1)
            text = self._prompt(here + angle_rad)
            if text is None:
                return
            if text != said and context.now - said_s > 0.5:
                turned_deg = math.degrees(self.gyro.angle_rad - here)
                context.show("turn", text, turned_deg=turned_deg, remaining=float(remaining))
                said, said_s = text, context.now
        raise PoorCalibration(
            f"The vehicle was not turned to a new position within {self.patience_s:.0f} s.",
            "Start again and turn it by about 90 degrees when asked.",
        )

    def _prompt(self, wanted_rad: float) -> str | None:
        """Return what the person has to do, None when the vehicle rests at a new position."""
        now = self.gyro.angle_rad
        nearest = min(abs(float(wrap_pi(now - v))) for v in self.visited_rad)
        left_deg = math.degrees(wanted_rad - now)
        if nearest >= self.apart_rad and abs(left_deg) > 20.0 and self.rest.for_s() > 0.7:
            return None
        if abs(left_deg) <= 20.0 and nearest >= self.apart_rad:
            return None if self.rest.for_s() > 0.3 else "Hold still."
        side = "right" if left_deg > 0.0 else "left"
        return f"Turn {side} {5 * round(abs(left_deg) / 5.0):.0f} deg more."

    def hold(self, context: Context) -> None:
        """Do nothing: the person holds it."""

    def halt(self, context: Context) -> None:
        """Do nothing: the person holds it."""


def wait_still(context: Context, rest: Rest, mover: Mover, settings: DwellSettings) -> Script[bool]:
    """Wait until the vehicle has rested for the settling time; False when it hunts on.

    Raises LinkLost where no IMU messages come.
    """
    end, heard_at = context.now + settings.patience_s, rest.time_s
    shown = False
    while rest.for_s() < settings.settle_s:
        if context.now > end:
            if rest.time_s == heard_at:
                raise LinkLost(
                    "No RAW_IMU or SCALED_IMU message came.",
                    "Check that the vehicle streams them on this link (SRn_RAW_SENS, MAV_n_MODE).",
                )
            return False
        if not shown and context.now > end - settings.patience_s + 1.0:
            context.show("settle", f"Waiting for rest: {rest.why_not}.")
            shown = True
        mover.hold(context)
        yield from pause(context, 0.1)
    return True


def dwell(
    context: Context, rest: Rest, gyro: GyroAngle, mover: Mover, settings: DwellSettings
) -> Script[Window]:
    """Stand still for a dwell; one that is disturbed begins anew, twice at the most."""
    for _ in range(3):
        resting = yield from wait_still(context, rest, mover, settings)
        start_s, angle, samples = rest.time_s, gyro.angle_rad, gyro.samples
        began, held_s = context.now, context.now
        while rest.time_s - start_s < settings.dwell_s:
            if context.now - began > 5.0 * settings.dwell_s + 5.0:
                raise LinkLost("The IMU messages stopped coming.", "Bring the link back and run again.")
            if context.now - held_s >= _HOLD_EVERY_S:
                mover.hold(context)
                held_s = context.now
            yield from pause(context, 0.05)
            if resting and rest.still_since_s is None:
                break
        else:
            if resting and gyro.samples > samples:
                _learn_bias(gyro, angle, rest.time_s - start_s)
            return Window(start_s, rest.time_s, gyro.angle_rad)
    return Window(start_s, rest.time_s, gyro.angle_rad)


def _learn_bias(gyro: GyroAngle, angle_before_rad: float, seconds: float) -> None:
    """Take what the gyro integrated at rest as its bias; live turns need no better one."""
    drift = (gyro.angle_rad - angle_before_rad) / seconds
    if abs(drift) < math.radians(2.0):
        gyro.note_rest(gyro.bias_radps + drift)


def visit(
    context: Context,
    rest: Rest,
    gyro: GyroAngle,
    mover: Mover,
    count: int,
    step_rad: float,
    settings: DwellSettings,
) -> Script[list[Window]]:
    """Visit `count` positions, `step_rad` apart as well as the vehicle can; the first is where it is."""
    windows: list[Window] = []
    for index in range(count):
        if index:
            context.show(
                "turn", f"Turning to position {index + 1} of {count}.", (index - 0.5) / (count + 1.0)
            )
            yield from mover.next(context, step_rad, count - index)
        context.show(
            "dwell",
            f"Position {index + 1} of {count}: standing still for {settings.dwell_s:.0f} s.",
            index / (count + 1.0),
            position=float(index + 1),
            turned_deg=math.degrees(gyro.angle_rad),
        )
        windows.append((yield from dwell(context, rest, gyro, mover, settings)))
    return windows
