"""Who turns the vehicle: itself, watched over by a guard, or a person.

Before a hovering copter holds its place it must not be turned. A compass that is suddenly far off takes the
estimator's heading along, the position controller then pushes the wrong way, and the copter swings in growing
circles until the satellite receiver's velocity has put the heading right. That takes ten seconds or so, and
nobody needs to do anything.

How still a copter can hold its place is a matter of its own noise. One that never gets slower than it is, but
wanders about one place and no wider than before, does what it can.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

from mavcompass import messages as mav
from mavcompass.errors import Refused
from mavcompass.kinds import HOVERING
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.readiness import Permissions, Readiness
from mavcompass.procedure.motion.safety import DRIFT_M, MotionGuard
from mavcompass.procedure.positions import HandMover, Mover, Rest, VehicleMover
from mavcompass.procedure.script import Context, Script, pause
from mavcompass.procedure.turning import (
    SteeredTurn,
    TurnBy,
    channels_moved,
    strategies_for,
    turned_otherwise,
    vehicle_profile,
)
from mavcompass.procedure.vehicle_state import VehicleState, metres_from

Motion = Literal["auto", "vehicle", "hand", "none"]

_ACKERMANN_STEERING = 26.0


@dataclass(slots=True)
class Mobility:
    """Choose who turns the vehicle, watch over it while it turns itself, put back what was changed.

    Attributes:
        motion, turn_by, permissions: as the person wants it; see `CalibrateSettings`.
        overrides: with these it may set an arming check aside.
        continuous: it is to turn all the way round without a stop.
    """

    desk: Desk
    motion: Motion = "auto"
    turn_by: TurnBy = "auto"
    permissions: Permissions = field(default_factory=Permissions)
    overrides: Overrides | None = None
    continuous: bool = False
    mover: Mover | None = None
    _modes: ModeKeeper = field(init=False)
    _readiness: Readiness | None = None
    _guard: MotionGuard | None = None

    def __post_init__(self) -> None:
        self._modes = ModeKeeper(self.desk.state, self.desk.identity.autopilot)

    def take_charge(self) -> Script[Mover]:
        """Return who turns the vehicle; from now on it is guarded where it turns itself.

        Raises Refused where it must not, or cannot, be turned in the way that was wished for.
        """
        desk, state, permissions = self.desk, self.desk.state, self.permissions
        while state.heartbeat is None:
            yield desk.context.now + 1.0
        if self.motion == "none":
            self.mover = Mover(desk.gyro, desk.rest)  # it stays where it stands
            return self.mover
        motion, armed = self.motion, state.armed
        if motion == "hand" and armed:
            raise Refused("The vehicle is armed: turning it by hand is not safe.", "Disarm it and run again.")
        if motion == "hand" or (motion == "auto" and not armed and not permissions.arm):
            self.mover = HandMover(desk.gyro, desk.rest)
            return self.mover
        strategies = self._strategies()
        controls = self.turn_by != "auto"
        self._readiness = Readiness(desk.identity, state, self._modes, permissions, controls, self.overrides)
        yield from self._readiness.make(desk.context)
        if desk.identity.kind in HOVERING:
            yield from wait_until_calm(desk.context, state, desk.rest)
        self._watch()
        self.mover = VehicleMover(desk.gyro, desk.rest, strategies)
        return self.mover

    def _strategies(self) -> tuple[SteeredTurn, ...]:
        kind, autopilot = self.desk.identity.kind, self.desk.identity.autopilot
        strategies = strategies_for(
            kind, autopilot, self._is_ackermann, self.turn_by, self._modes, self.continuous
        )
        if not strategies and self.continuous:
            raise Refused(
                f"No way is known in which this {autopilot} {kind} turns all the way round without a stop.",
                "Leave --continuous away: it then stops at each position.",
            )
        if not strategies:
            how = f"turns itself on the spot{turned_otherwise(kind, autopilot)}"
            raise Refused(
                f"There is no known way in which this {autopilot} {kind} {how}.",
                "Disarm it and turn it by hand with --motion hand.",
            )
        return strategies

    def _watch(self) -> None:
        desk, kind = self.desk, self.desk.identity.kind
        profile = vehicle_profile(kind, desk.identity.autopilot, self._is_ackermann)
        room_m = DRIFT_M if profile is None else max(DRIFT_M, profile.drift_m)
        ours = channels_moved(kind, self.turn_by)
        self._guard = guard = MotionGuard(desk.state, desk.gyro, kind, self._modes, room_m, ours)
        guard.begin()
        desk.context.listeners.append(guard.hear)
        desk.context.watches.append(guard.check)

    @property
    def _is_ackermann(self) -> bool:
        return self.desk.parameters.get("SERVO1_FUNCTION") == _ACKERMANN_STEERING

    @property
    def steers_astray(self) -> bool:
        """Tell whether the vehicle itself has refused to move by its compass as that is."""
        return self._readiness is not None and self._readiness.exempted

    @property
    def has_room(self) -> bool:
        """Tell whether the vehicle may stray as far again as it has."""
        return self._guard is None or 2.0 * self._guard.strayed_m < self._guard.room_m

    def halt(self) -> None:
        """End any motion for good; what may not have heard it is told again as soon as it speaks.

        In a mode that somebody else chose our commands would only disturb, a mission for one; the pilot's
        own controls are given back in any.
        """
        context, mover = self.desk.context, self.mover
        if mover is not None and (self.turn_by != "auto" or not self._modes.is_foreign()):
            mover.halt(context)
            context.listeners.append(lambda _: mover.halt(context))

    def end(self, in_a_hurry: bool) -> Script[None]:
        """Stop any motion, end the watch, and give the vehicle back as it was taken."""
        context = self.desk.context
        context.watches.clear()
        self.halt()
        if self.mover is not None:
            yield from self.mover.release(context)
        if self._readiness is not None:
            yield from self._readiness.put_back(context, in_a_hurry)


# --- a copter that holds its place ----------------------------------------------------------------

_POLL_S = 0.1
# So long it must have held its place.
_CALM_S = 1.5
_FASTEST_MPS = 0.5
# ArduPilot's own limits of what its estimator makes of its measurements: beyond, it will not stay as it is.
_COMPASS_VARIANCE, _VELOCITY_VARIANCE = 0.8, 0.3
# A copter that swings is given this long; one that hovers well though its estimator doubts the compass, this.
_PATIENCE_S, _DOUBT_PATIENCE_S = 40.0, 10.0
# A copter that wanders is watched for two such stretches; so far apart its places may lie in the later one,
# and so much further than in the earlier one by chance.
_STRETCH_S, _WIDEST_M, _NO_WIDER = 6.0, 2.0, 1.25


def wait_until_calm(context: Context, state: VehicleState, rest: Rest) -> Script[None]:
    """Wait until the copter hovers at its place. Raises Refused where it does not come to that."""
    began_s = calm_since_s = held_since_s = level_since_s = context.now
    said, wander = False, _Wander()
    while True:
        wander.note(context.now, state)
        if rest.why_not == "tilting":
            level_since_s = context.now
        if _swings(state, rest):
            calm_since_s = held_since_s = context.now
        elif _doubts(state):
            calm_since_s = context.now
        if context.now - calm_since_s >= _CALM_S or context.now - held_since_s >= _DOUBT_PATIENCE_S:
            return
        if context.now - level_since_s >= _CALM_S and wander.keeps_to_its_place():
            context.show(
                "ready", f"The vehicle wanders by {wander.reach_m():.1f} m; it holds its place so well."
            )
            return
        if context.now - began_s > _PATIENCE_S:
            raise Refused(
                f"The vehicle does not hold its place within {_PATIENCE_S:.0f} s.",
                "Land it and calibrate it on the ground, turned by hand: --motion hand.",
            )
        if not said and context.now - began_s > _CALM_S + 1.0:
            context.show("ready", "Waiting until the vehicle holds its place.")
            said = True
        yield from pause(context, _POLL_S)


@dataclass(slots=True)
class _Wander:
    """Follow where the vehicle was: metres north and east of where it was first."""

    _start: mav.GlobalPositionInt | None = None
    _places: deque[tuple[float, float, float]] = field(default_factory=deque)

    def note(self, now_s: float, state: VehicleState) -> None:
        """Take the vehicle's latest place."""
        if (place := state.place) is None:
            return
        self._start = self._start or place
        self._places.append((now_s, *metres_from(self._start, place)))
        while self._places[0][0] < now_s - 2.0 * _STRETCH_S:
            self._places.popleft()

    def reach_m(self, back: int = 0) -> float:
        """Return how far apart the places of a stretch lie: the latest, or the one before."""
        until_s = self._places[-1][0] - back * _STRETCH_S
        inside = [p for p in self._places if until_s - _STRETCH_S < p[0] <= until_s]
        return math.hypot(*(max(p[axis] for p in inside) - min(p[axis] for p in inside) for axis in (1, 2)))

    def keeps_to_its_place(self) -> bool:
        """Tell whether it wandered no wider in the latest stretch than in the one before, nor far."""
        if not self._places or self._places[-1][0] - self._places[0][0] < 2.0 * _STRETCH_S - 2.0 * _POLL_S:
            return False
        return self.reach_m() <= min(_WIDEST_M, _NO_WIDER * self.reach_m(1))


def _swings(state: VehicleState, rest: Rest) -> bool:
    return state.speed_mps > _FASTEST_MPS or rest.why_not == "tilting"


def _doubts(state: VehicleState) -> bool:
    ekf = state.ekf
    return ekf is not None and (
        ekf.compass_variance >= _COMPASS_VARIANCE or ekf.velocity_variance >= _VELOCITY_VARIANCE
    )
