"""Flight modes: which one turning needs, changing it where a person asked for that, putting it back."""

from __future__ import annotations

from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.enums import CopterMode, MavCmd, MavResult, PlaneMode, RoverMode, SubMode
from mavcompass.kinds import Kind
from mavcompass.procedure.script import Context, Script
from mavcompass.procedure.vehicle_state import VehicleState

_CUSTOM_MODE = 1.0
PX4_OFFBOARD = 6 << 16
_PX4_LAND = 4 << 16 | 6 << 24
# A vehicle that says nothing for so long is not asked any more.
_SILENCE_S = 3.0
_CHANGE_WITHIN_S = 5.0
_BEATS_WITHIN_S = 1.5
_GUIDED: dict[str, int] = {
    "rover": RoverMode.GUIDED,
    "boat": RoverMode.GUIDED,
    "copter": CopterMode.GUIDED,
    "sub": SubMode.GUIDED,
}
# In which the pilot's controls turn it; a quadplane stays at its place and height meanwhile.
_BY_CONTROLS: dict[str, int] = {
    "rover": RoverMode.MANUAL,
    "boat": RoverMode.MANUAL,
    "sub": SubMode.MANUAL,
    "vtol": PlaneMode.QLOITER,
}
_LANDING: dict[str, int] = {"copter": CopterMode.LAND, "vtol": PlaneMode.QLAND}
_NAMES: dict[str, type[RoverMode] | type[CopterMode] | type[SubMode] | type[PlaneMode]] = {
    "rover": RoverMode,
    "boat": RoverMode,
    "copter": CopterMode,
    "sub": SubMode,
    "plane": PlaneMode,
    "vtol": PlaneMode,
}
_PX4_NAMES = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    4: "AUTO",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
}


def turning_mode(kind: Kind, autopilot: str, by_controls: bool = False) -> int | None:
    """Return the mode in which a vehicle takes turns from us; None where any will do or none is known.

    PX4's OFFBOARD is entered by its strategy, which has to stream targets first.
    """
    if autopilot != "ardupilot":
        return None
    return (_BY_CONTROLS if by_controls else _GUIDED).get(kind)


def landing_mode(kind: Kind, autopilot: str) -> int:
    """Return the mode in which what hovers lands where it is."""
    return _PX4_LAND if autopilot == "px4" else _LANDING[kind]


def mode_name(kind: Kind, autopilot: str, mode: int) -> str:
    """Return a mode's name for a person, its number where it has none here."""
    if autopilot == "px4":
        return _PX4_NAMES.get(mode >> 16 & 0xFF, f"mode {mode}")
    names = _NAMES.get(kind)
    return names(mode).name if names is not None and mode in list(names) else f"mode {mode}"


def command_mode(context: Context, autopilot: str, mode: int) -> None:
    """Send the command that changes to a mode, given as in HEARTBEAT.custom_mode."""
    main, sub = (mode >> 16 & 0xFF, mode >> 24 & 0xFF) if autopilot == "px4" else (mode, 0)
    context.command(MavCmd.DO_SET_MODE, _CUSTOM_MODE, main, sub)


@dataclass(slots=True)
class ModeKeeper:
    """Change a vehicle's mode, know which modes are ours, put back the one it had.

    Attributes:
        ours: modes that the vehicle may be in because of us. Any other is somebody else's doing.
        before: the modes to put back, the latest last.
    """

    state: VehicleState
    autopilot: str
    ours: set[int] = field(default_factory=set)
    before: list[int] = field(default_factory=list)
    _coming: int | None = None

    def accept_present(self) -> None:
        """Take the present mode as agreed upon."""
        self.ours, self._coming = {self.state.mode}, None

    def is_foreign(self) -> bool:
        """Tell whether the vehicle is in a mode that somebody else has put it into."""
        if self.state.mode == self._coming:
            # It has arrived: from now on the mode before would be somebody else's wish.
            self.accept_present()
        return self.state.mode not in self.ours

    def change(self, context: Context, mode: int) -> Script[bool]:
        """Change to a mode and wait until the vehicle says that it is in it; False where it refuses.

        `restore` leads back from it.
        """
        self.before.append(self.state.mode)
        return (yield from self.go_to(context, mode))

    def restore(self, context: Context) -> Script[None]:
        """Put the mode before the last change back, unless somebody else has chosen another since.

        The next heartbeat tells: a failsafe's reason may have come before what it does.
        """
        mode = self.before.pop() if self.before else None
        told, end_s = self.state.heartbeat, context.now + _BEATS_WITHIN_S
        while mode is not None and self.state.heartbeat is told and context.now < end_s:
            yield end_s
        if mode is not None and not self.is_foreign():
            yield from self.go_to(context, mode)

    def go_to(self, context: Context, mode: int) -> Script[bool]:
        """Change to a mode for good; False where the vehicle refuses."""
        self.ours, self._coming = {self.state.mode, mode}, mode
        if (yield from self._command_until_heard(context, mode)):
            self.accept_present()
            return True
        return False

    def _command_until_heard(self, context: Context, mode: int) -> Script[bool]:
        end_s, ask_s, refusals = context.now + _CHANGE_WITHIN_S, context.now, 0
        if self.state.mode == mode:
            return True
        while context.now < end_s and context.now - self.state.heard_s < _SILENCE_S:
            if context.now >= ask_s:
                command_mode(context, self.autopilot, mode)
                ask_s = context.now + 0.7
            heard = context.heard_from_vehicle((yield min(end_s, ask_s)))
            if self.state.mode == mode:
                return True
            if heard is None or not isinstance(heard.message, mav.CommandAck):
                continue
            if heard.message.command == MavCmd.DO_SET_MODE:
                if heard.message.result == MavResult.ACCEPTED:
                    ask_s = max(ask_s, context.now + 1.5)  # the next heartbeat will tell
                else:
                    refusals += 1
                    if refusals >= 2:
                        return False
        return False
