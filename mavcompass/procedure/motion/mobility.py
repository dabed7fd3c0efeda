"""Who turns the vehicle: itself, watched over by a guard, or a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from mavcompass.errors import Refused
from mavcompass.kinds import Kind
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.calm import wait_until_calm
from mavcompass.procedure.motion.readiness import Permissions, Readiness
from mavcompass.procedure.motion.safety import MotionGuard, SafetyLimits
from mavcompass.procedure.positions import HandMover, Mover, Rest, VehicleMover
from mavcompass.procedure.script import Context, Script
from mavcompass.procedure.turning import (
    GyroAngle,
    TurnBy,
    TurnStrategy,
    strategies_for,
    vehicle_profile,
)
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState

Motion = Literal["auto", "vehicle", "hand", "none"]

_ACKERMANN_STEERING = 26.0


@dataclass(slots=True)
class Mobility:
    """Choose who turns the vehicle, watch over it while it turns itself, put back what was changed.

    Attributes:
        motion, turn_by, permissions, limits: as the person wants it; see `CalibrateSettings`.
        overrides: with these it may set an arming check aside.
    """

    identity: VehicleIdentity
    state: VehicleState
    gyro: GyroAngle
    rest: Rest
    motion: Motion = "auto"
    turn_by: TurnBy = "auto"
    permissions: Permissions = field(default_factory=Permissions)
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    overrides: Overrides | None = None
    mover: Mover | None = None
    _modes: ModeKeeper = field(init=False)
    _readiness: Readiness | None = None
    _guard: MotionGuard | None = None

    def __post_init__(self) -> None:
        self._modes = ModeKeeper(self.state, self.identity.autopilot)

    def take_charge(self, context: Context, parameters: Mapping[str, float]) -> Script[Mover]:
        """Return who turns the vehicle; from now on it is guarded where it turns itself.

        Raises Refused where it must not, or cannot, be turned in the way that was wished for.
        """
        while self.state.heartbeat is None:
            yield context.now + 1.0
        if self.motion == "none":
            self.mover = Mover()  # it stays where it stands
            return self.mover
        motion, armed, permissions = self.motion, self.state.armed, self.permissions
        if motion == "hand" and armed:
            raise Refused("The vehicle is armed: turning it by hand is not safe.", "Disarm it and run again.")
        if motion == "hand" or (motion == "auto" and not armed and not permissions.arm):
            self.mover = HandMover(self.gyro, self.rest)
            return self.mover
        strategies = self._strategies(parameters)
        controls = self.turn_by != "auto"
        self._readiness = Readiness(
            self.identity, self.state, self._modes, permissions, controls, self.overrides
        )
        yield from self._readiness.make(context)
        if self.identity.kind == "copter":
            yield from wait_until_calm(context, self.state, self.rest)
        self._watch(context, parameters)
        self.mover = VehicleMover(self.gyro, strategies)
        return self.mover

    def _strategies(self, parameters: Mapping[str, float]) -> tuple[TurnStrategy, ...]:
        kind, autopilot = self.identity.kind, self.identity.autopilot
        strategies = strategies_for(
            kind, autopilot, self._is_ackermann(parameters), self.turn_by, self._modes
        )
        if not strategies:
            raise Refused(
                f"There is no known way in which this {autopilot} {kind} turns itself on the spot.",
                "Disarm it and turn it by hand with --motion hand.",
            )
        return strategies

    def _watch(self, context: Context, parameters: Mapping[str, float]) -> None:
        limits = self.limits
        kind, autopilot = self.identity.kind, self.identity.autopilot
        profile = vehicle_profile(kind, autopilot, self._is_ackermann(parameters))
        if profile is not None:
            limits = limits.with_drift(max(limits.drift_m, profile.drift_m))
        ours = _channels_moved(self.turn_by, kind)
        self._guard = MotionGuard(self.state, self.gyro, kind, limits, self._modes, ours)
        self._guard.begin()
        context.listeners.append(self._guard.hear)
        context.watches.append(self._guard.check)

    @staticmethod
    def _is_ackermann(parameters: Mapping[str, float]) -> bool:
        return parameters.get("SERVO1_FUNCTION") == _ACKERMANN_STEERING

    def end(self, context: Context, in_a_hurry: bool) -> Script[None]:
        """Stop any motion, end the watch, and give the vehicle back as it was taken."""
        context.watches.clear()
        if self.mover is not None:
            # In a mode that somebody else chose our commands would only disturb, a mission for one;
            # the pilot's own controls are given back in any.
            if self.turn_by != "auto" or not self._modes.is_foreign():
                self.mover.halt(context)
            yield from self.mover.release(context)
        if self._readiness is not None:
            yield from self._readiness.put_back(context, in_a_hurry)


def _channels_moved(by: TurnBy, kind: Kind) -> frozenset[int]:
    """List the RC channels that turning moves: they say nothing about the pilot."""
    match by:
        case "rc-override":
            return frozenset({4} if kind == "sub" else {1})
        case "manual-control":
            return frozenset({1, 2, 3, 4})
    return frozenset()
