"""ArduPilot's modes, as far as they decide who steers a simulated vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.enums import CopterMode, MavModeFlag, MavSeverity, PlaneMode, RoverMode, SubMode
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import GroundGuidance, HoverGuidance
from mavcompass.simulation.physics.profiles import VehicleProfile

_NAMES: dict[str, dict[str, int]] = {
    "rover": {m.name: int(m) for m in RoverMode},
    "copter": {m.name: int(m) for m in CopterMode},
    "sub": {m.name: int(m) for m in SubMode},
    # Those in which its rotors hold it; it is not simulated on its wings.
    "plane": {m.name.removeprefix("Q"): int(m) for m in PlaneMode if m.name.startswith("Q")},
}


@dataclass(frozen=True, slots=True)
class ModeRules:
    """Sort one firmware's modes.

    Attributes:
        names: mode name -> HEARTBEAT.custom_mode.
        by_hand: the pilot's sticks steer; autonomous: the heartbeat says GUIDED_ENABLED.
        need_position: cannot be entered before the position is known.
        cannot_arm: arming is refused in these; impossible: needs a mission, or is not simulated.
    """

    names: dict[str, int]
    by_hand: frozenset[str]
    autonomous: frozenset[str]
    need_position: frozenset[str]
    cannot_arm: frozenset[str]
    impossible: frozenset[str] = frozenset({"AUTO"})

    def name(self, number: int) -> str | None:
        """Return a mode's name, None for a number that this firmware does not know."""
        return next((n for n, value in self.names.items() if value == number), None)

    def base_mode(self, mode: str, armed: bool, firmware: str) -> MavModeFlag:
        """Return HEARTBEAT.base_mode."""
        flags = MavModeFlag.CUSTOM_MODE_ENABLED
        if firmware != "rover":
            flags |= MavModeFlag.STABILIZE_ENABLED | MavModeFlag.MANUAL_INPUT_ENABLED
        elif mode in self.by_hand:
            flags |= MavModeFlag.MANUAL_INPUT_ENABLED
        if mode in self.autonomous:
            flags |= MavModeFlag.GUIDED_ENABLED
        if armed:
            flags |= MavModeFlag.SAFETY_ARMED
        return flags


_RULES = {
    "rover": ModeRules(
        _NAMES["rover"],
        by_hand=frozenset({"MANUAL", "ACRO", "STEERING"}),
        autonomous=frozenset({"AUTO", "RTL", "GUIDED", "LOITER"}),
        need_position=frozenset({"AUTO", "RTL", "GUIDED", "LOITER"}),
        cannot_arm=frozenset({"RTL"}),
    ),
    "copter": ModeRules(
        _NAMES["copter"],
        by_hand=frozenset({"STABILIZE", "ALT_HOLD", "LOITER", "POSHOLD"}),
        autonomous=frozenset({"AUTO", "RTL", "GUIDED", "LAND"}),
        need_position=frozenset({"AUTO", "RTL", "GUIDED", "LOITER", "POSHOLD", "BRAKE"}),
        cannot_arm=frozenset({"AUTO", "RTL", "LAND", "BRAKE"}),
    ),
    "sub": ModeRules(
        _NAMES["sub"],
        by_hand=frozenset({"STABILIZE", "ALT_HOLD", "POSHOLD", "MANUAL"}),
        autonomous=frozenset({"AUTO", "GUIDED", "SURFACE"}),
        need_position=frozenset({"AUTO", "GUIDED", "POSHOLD"}),
        cannot_arm=frozenset({"SURFACE"}),
    ),
    "plane": ModeRules(
        _NAMES["plane"],
        by_hand=frozenset({"STABILIZE", "HOVER", "LOITER"}),
        autonomous=frozenset({"RTL", "LAND"}),
        need_position=frozenset({"RTL", "LOITER"}),
        cannot_arm=frozenset({"RTL", "LAND"}),
    ),
}


def mode_rules(profile: VehicleProfile) -> ModeRules:
    """Return the rules of a vehicle's firmware."""
    return _RULES[profile.firmware]


@dataclass(slots=True, eq=False)
class Modes:
    """Change modes, and let guidance begin anew in the new one."""

    board: Board
    status: Status
    rules: ModeRules
    ground: GroundGuidance
    hover: HoverGuidance

    def enter_number(self, number: int) -> bool:
        """Change to the mode of a number; False where it is refused."""
        name = self.rules.name(number)
        return name is not None and self.enter(name)

    def enter(self, name: str) -> bool:
        """Change mode; False where it is refused."""
        rules, board = self.rules, self.board
        if name in rules.impossible or name not in rules.names:
            return False
        if name in rules.need_position and not board.ready:
            board.say(f"Mode change to {name} failed: requires position", MavSeverity.WARNING)
            return False
        if name != self.status.mode:
            self.status.mode = name
            self.ground.stop()
            if self.status.armed and not board.body.landed:
                self.hover.hold_here()
        return True
