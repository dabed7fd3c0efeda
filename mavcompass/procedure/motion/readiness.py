"""Make a vehicle ready to turn itself, as far as a person asked for it, and put it back afterwards.

Nothing is armed, switched in mode or taken off without its own permission. Where arming is refused for the
compass alone, which is the one to be calibrated, that check is set aside until it is armed, with consent.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoReply, Refused
from mavcompass.kinds import HOVERING
from mavcompass.procedure.commands import command
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.modes import ModeKeeper, landing_mode, mode_name, turning_mode
from mavcompass.procedure.script import Ask, Context, Script, ask, pause
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState

_CLIMB_PATIENCE_S = 40.0
_LANDING_PATIENCE_S = 90.0
# Where a vehicle is, is told twice a second at least once it is asked for.
_PLACE_WITHIN_S = 3.0
# PX4 was seen to take a yaw over within 4 s; its place and its home follow.
_INSISTS_S = 12.0
# ArduPilot was seen to use its receiver 41 s after its start, and not to arm before.
_STARTS_S, _AGAIN_S = 60.0, 2.0
# After a stop nothing is waited for: the autopilot lands by itself once told to.
_HURRIED_S = 3.0
# ArduPilot and PX4 name every reason not to arm, each in a text.
_REASON = re.compile(r"(?:(?:Pre)?Arm|Preflight Fail): ?(.*)")
_PX4_TAKEOFF, _PX4_HOLD = (4 << 16 | sub << 24 for sub in (2, 3))


@dataclass(frozen=True, slots=True)
class Permissions:
    """Hold what a person allowed to be done to the vehicle.

    Attributes:
        set_mode: change the flight mode. arm: arm it. takeoff_m: take off to this height (0: never).
        land: land a copter afterwards that was flying before.
        exempt: set the compass's arming check aside where that alone keeps it from arming.
    """

    set_mode: bool = False
    arm: bool = False
    takeoff_m: float = 0.0
    land: bool = False
    exempt: Literal["ask", "yes", "never"] = "ask"


def arming_reasons(said: Sequence[str]) -> list[str]:
    """Return why a vehicle does not arm, out of what it said."""
    return [reason[1] for text in said if (reason := _REASON.match(text))]


@dataclass(slots=True)
class Readiness:
    """Make ready, and put back: the flight mode, the arming, the place on the ground.

    Attributes:
        exempted: True where it armed only with the compass's check set aside.
    """

    identity: VehicleIdentity
    state: VehicleState
    modes: ModeKeeper
    permissions: Permissions = Permissions()
    by_controls: bool = False
    overrides: Overrides | None = None
    exempted: bool = False
    _armed_by_us: bool = field(default=False)
    _asked_s: float = math.inf
    _in_the_air_by_us: bool = field(default=False)

    def make(self, context: Context) -> Script[None]:
        """Bring the vehicle into a state in which it can turn itself.

        Raises Refused where that needs a permission that was not given, or the vehicle will not.
        """
        self.modes.accept_present()
        yield from self._into_mode(context)
        if not self.state.armed:
            yield from self._arm(context)
        if self.permissions.takeoff_m > 0.0 and self.identity.kind in HOVERING:
            end_s = context.now + _PLACE_WITHIN_S
            while self.state.place is None and context.now < end_s:
                yield end_s  # it may be in the air already
            if self._height_m() < 1.0:
                yield from self._take_off(context)
        self.modes.accept_present()

    def put_back(self, context: Context, in_a_hurry: bool) -> Script[None]:
        """Undo what `make` did, the last thing first; what a pilot has taken over is left to the pilot.

        In a hurry, after a stop, a copter is told to land and not waited for.
        """
        if self.modes.is_foreign():
            return
        try:
            if self._in_the_air_by_us or (self.permissions.land and self._flies()):
                yield from self._land(context, _HURRIED_S if in_a_hurry else _LANDING_PATIENCE_S)
            elif self._armed_by_us:
                yield from command(context, MavCmd.COMPONENT_ARM_DISARM, 0.0, what="disarming")
            while self.modes.before:
                yield from self.modes.restore(context)
        except NoReply as lost:
            context.show("end", f"The vehicle may not be as it was: {lost.what}")

    # --- steps --------------------------------------------------------------------------------------

    def _into_mode(self, context: Context) -> Script[None]:
        wanted = turning_mode(self.identity.kind, self.identity.autopilot, self.by_controls)
        if wanted is None or self.state.mode == wanted:
            return
        there = mode_name(self.identity.kind, self.identity.autopilot, wanted)
        if not self.permissions.set_mode:
            here = mode_name(self.identity.kind, self.identity.autopilot, self.state.mode)
            raise Refused(
                f"The vehicle is in {here}; it turns itself in {there} only.",
                f"Switch it to {there}, or allow that with --set-mode.",
            )
        context.show("ready", f"Changing the flight mode to {there}.")
        self._asked_s = context.now
        while not (yield from self.modes.change(context, wanted)):
            if not (yield from self._starts(context, self._why())):
                raise Refused(
                    f"The vehicle refused the flight mode {there}.{self._why()}",
                    "Wait until it knows its position, then run again.",
                )

    def _arm(self, context: Context) -> Script[None]:
        if not self.permissions.arm:
            raise Refused(
                "The vehicle is disarmed, so it cannot turn itself.",
                "Arm it (a copter: take off), allow that with --arm, or turn it by hand with --motion hand.",
            )
        context.show("ready", "Arming.")
        aside = yield from self._try_to_arm(context)
        while not self.state.armed and not aside and (yield from self._starts(context, self._why())):
            aside = yield from self._try_to_arm(context)
        own = self.overrides
        if own is not None and aside and (yield from self._may_set_aside(context, aside)):
            yield from own.hold(context, aside)
            why = "The arming check is asked again."
            yield from own.put_back_after(context, self._insist(context), why)
            # With the check aside PX4 takes a yaw over, calls it not stable while it follows a compass
            # that it doubts, and keeps it when the check is back.
            yield from self._insist(context)
            self.exempted = self.state.armed
        if not self.state.armed:
            raise Refused(
                f"The vehicle refused to arm.{self._why()}",
                "Put right what it names, then run again; turning it by hand needs no arming.",
            )

    def _insist(self, context: Context) -> Script[None]:
        """Ask it to arm until it does: PX4's estimator needs some seconds for what it did not use before."""
        end_s = context.now + _INSISTS_S
        while not self.state.armed and context.now < end_s:
            yield from self._ask(context, MavCmd.COMPONENT_ARM_DISARM, 1.0, what="arming")

    def _ask(self, context: Context, number: MavCmd, *parameters: float, what: str) -> Script[None]:
        """Ask it to arm, or why not, and listen a while: texts come beside the answer."""
        try:
            with context.station(self.identity.autopilot == "px4"):
                yield from command(context, number, *parameters, what=what)
                end_s = context.now + 3.0
                while context.now < end_s and not self.state.armed:
                    yield from pause(context, 0.1)
        finally:
            self._armed_by_us = self.state.armed

    def _try_to_arm(self, context: Context) -> Script[Mapping[str, float]]:
        """Ask it to arm; return what sets the compass's arming check aside, where that alone refuses."""
        self._asked_s = context.now
        yield from self._ask(context, MavCmd.COMPONENT_ARM_DISARM, 1.0, what="arming")
        if self.state.armed or self.overrides is None:
            return {}
        exemption = self.overrides.dialect.arming_exemption
        values = yield from exemption(context, arming_reasons(self.state.said_since(self._asked_s)))
        if not values:  # PX4 says why when that begins, and when it is asked for it; not when it refuses
            yield from self._ask(context, MavCmd.RUN_PREARM_CHECKS, what="its arming checks")
            values = yield from exemption(context, arming_reasons(self.state.said_since(self._asked_s)))
        return values

    def _may_set_aside(self, context: Context, values: Mapping[str, float]) -> Script[bool]:
        """Tell whether a person agrees that the compass's arming check is set aside."""
        what = "It refuses to arm for nothing but the compass, which is the one to be calibrated"
        aside = " and ".join(f"{name} {value:.0f}" for name, value in values.items())
        if self.permissions.exempt == "yes":
            context.show("ready", f"{what}: arming with that check set aside ({aside}).")
        if self.permissions.exempt != "ask":
            return self.permissions.exempt == "yes"
        question = Ask(
            f"Set the compass's arming check aside until it is armed ({aside})?",
            (f"{what}.{self._why()} All other checks stay.",),
        )
        return (yield from ask(context, question))

    def _starts(self, context: Context, words: str) -> Script[bool]:
        """Give a vehicle time that was started a moment ago, by its own clock; False where it was not."""
        attitude = self.state.attitude
        if attitude is None or attitude.time_boot_ms > 1000.0 * _STARTS_S:
            return False
        context.show("ready", f"It was started a moment ago and is not ready yet.{words}")
        yield from pause(context, _AGAIN_S)
        return True

    def _take_off(self, context: Context) -> Script[None]:
        height_m = self.permissions.takeoff_m
        context.show("ready", f"Taking off to {height_m:.0f} m.")
        px4 = self.identity.autopilot == "px4"
        place = self.state.place
        ground_m = place.alt * 1e-3 if px4 and place is not None else 0.0
        free = math.nan if px4 else 0.0
        self._in_the_air_by_us, self._asked_s = True, context.now
        if px4:
            self.modes.before.append(self.state.mode)
            self.modes.ours |= {_PX4_TAKEOFF, _PX4_HOLD}
        result = yield from command(
            context,
            MavCmd.NAV_TAKEOFF,
            *(0.0, 0.0, 0.0, free, free, free, ground_m + height_m),
            what="the take-off",
        )
        end_s = context.now + (_CLIMB_PATIENCE_S if result == MavResult.ACCEPTED else 0.0)
        while self._height_m() < 0.93 * height_m:
            if context.now >= end_s or not self.state.armed:
                raise Refused(
                    f"The vehicle did not take off.{self._why()}",
                    "Take off by hand and run again.",
                )
            yield from pause(context, 0.1)
        yield from pause(context, 2.0)  # to come to rest

    def _land(self, context: Context, patience_s: float) -> Script[None]:
        """Land where it is; whatever ends the wait, the autopilot goes on landing."""
        mode = landing_mode(self.identity.kind, self.identity.autopilot)
        context.show("end", "Landing.")
        if not (yield from self.modes.go_to(context, mode)):
            context.show("end", "The vehicle did not take the command to land: land it by hand.")
            self.modes.before.clear()
            return
        end_s = context.now + patience_s
        while self.state.armed and context.now < end_s and not self.modes.is_foreign():
            yield from pause(context, 0.2)
        if self.state.armed:
            self.modes.before.clear()

    def _flies(self) -> bool:
        return self.identity.kind in HOVERING and self.state.armed

    def _height_m(self) -> float:
        return 0.0 if self.state.place is None else self.state.place.relative_alt * 1e-3

    def _why(self) -> str:
        """Return why it does not, as it said since it was asked."""
        said = self.state.said_since(self._asked_s)
        reasons = dict.fromkeys(arming_reasons(said) or said[-1:])
        return f" It said: {'; '.join(reasons)}." if reasons else ""
