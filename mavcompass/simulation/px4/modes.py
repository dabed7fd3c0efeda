"""PX4's modes: a main mode in bits 16-23 of HEARTBEAT.custom_mode and a sub mode in bits 24-31."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.enums import MavModeFlag, MavSeverity
from mavcompass.simulation.autopilot import Board, HoverGuidance, Status
from mavcompass.simulation.px4.setpoints import Setpoints

_AUTO = 4
_MODES: dict[str, tuple[int, int]] = {
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "TAKEOFF": (_AUTO, 2),
    "HOLD": (_AUTO, 3),
    "MISSION": (_AUTO, 4),
    "RTL": (_AUTO, 5),
    "LAND": (_AUTO, 6),
    "ACRO": (5, 0),
    "OFFBOARD": (6, 0),
    "STABILIZED": (7, 0),
}
BY_HAND = frozenset({"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"})
NEED_POSITION = frozenset({"POSCTL", "TAKEOFF", "HOLD", "MISSION", "RTL", "OFFBOARD"})
IMPOSSIBLE = frozenset({"MISSION"})


def mode_of(main: int, sub: int) -> str | None:
    """Return the mode of a main and a sub mode, None for what is none."""
    return next((name for name, numbers in _MODES.items() if numbers == (main, sub)), None)


def mode_of_custom(custom_mode: int) -> str | None:
    """Return the mode of HEARTBEAT.custom_mode."""
    return mode_of(custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)


def custom_mode(name: str) -> int:
    """Return HEARTBEAT.custom_mode of a mode."""
    main, sub = _MODES[name]
    return main << 16 | sub << 24


def base_mode(name: str, armed: bool) -> MavModeFlag:
    """Return HEARTBEAT.base_mode."""
    flags = MavModeFlag.CUSTOM_MODE_ENABLED | MavModeFlag.STABILIZE_ENABLED
    if name in BY_HAND:
        flags |= MavModeFlag.MANUAL_INPUT_ENABLED
    else:
        flags |= MavModeFlag.GUIDED_ENABLED | MavModeFlag.AUTO_ENABLED
    return flags | MavModeFlag.SAFETY_ARMED if armed else flags


@dataclass(slots=True, eq=False)
class Modes:
    """Change modes, and hold heading and height on entering one."""

    board: Board
    status: Status
    hover: HoverGuidance
    setpoints: Setpoints

    def enter(self, name: str | None) -> bool:
        """Change mode; False where it is refused."""
        if name not in _MODES or name in IMPOSSIBLE:
            return False
        if name in NEED_POSITION and not self.board.ready:
            return False
        if name == "OFFBOARD" and not self.setpoints.flow:
            self.board.say("Switching to Offboard is currently not available", MavSeverity.CRITICAL)
            return False
        if name != self.status.mode:
            self.status.mode = name
            if not self.board.body.landed:
                self.hover.hold_here()
        return True
