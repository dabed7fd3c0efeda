"""How PX4 flies: its modes, its arming with its refusals, and the setpoints of OFFBOARD.

A mode is a main mode in bits 16-23 of HEARTBEAT.custom_mode and a sub mode in bits 24-31. OFFBOARD wants a
stream of setpoints before the switch and as long as it lasts.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from mavcompass.enums import MavFrame, MavModeFlag, MavSeverity
from mavcompass.messages import SetPositionTargetLocalNed
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import HoverGuidance, Ignore, Radio, Target, stick
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.px4.compasses import Px4Compasses

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
# Setpoints must come faster than 2 Hz to be a stream.
_SLOWEST_S = 0.5


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


class Setpoints:
    """Note when setpoints came."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._heard_s: deque[float] = deque(maxlen=3)

    def forget(self) -> None:
        """Begin anew."""
        self._heard_s.clear()

    def heard(self) -> None:
        """Note one."""
        self._heard_s.append(self._board.boot_time_s)

    @property
    def flow(self) -> bool:
        """Tell whether setpoints have come, and come, as a stream."""
        gaps = [b - a for a, b in pairwise((*self._heard_s, self._board.boot_time_s))]
        return len(self._heard_s) == self._heard_s.maxlen and max(gaps) <= _SLOWEST_S

    @property
    def silent_s(self) -> float:
        """Return the time since the last one; infinite where none came."""
        return self._board.boot_time_s - self._heard_s[-1] if self._heard_s else math.inf


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


@dataclass(slots=True, eq=False)
class Arming:
    """Arm and disarm; say why not."""

    board: Board
    status: Status
    store: ParameterStore
    compasses: Px4Compasses

    def refusal(self) -> str | None:
        """Say why it will not arm, None where it will."""
        compasses = self.compasses
        if not self.board.ready:
            return "Preflight Fail: ekf2 missing data"
        if compasses.steering is None or not compasses.healthy(compasses.steering):
            return "Preflight Fail: No valid data from Compass 0"
        first, second = (math.atan2(-field[1], field[0]) for field in compasses.fields[:2])
        apart = abs(math.degrees(math.remainder(first - second, 2.0 * math.pi)))
        if 0.0 < self.store["COM_ARM_MAG_ANG"] < apart:
            return "Preflight Fail: Compasses inconsistent"
        return None

    def arm(self, forced: bool) -> bool:
        """Arm if nothing speaks against it, or forced."""
        if not forced and self.refusal():
            # Why, it said when that began, and says to who asks (RUN_PREARM_CHECKS).
            self.board.say("Arming denied: Resolve system health failures first", MavSeverity.CRITICAL)
            return False
        self.status.armed = True
        self.board.say("Armed by external command")
        return True

    def disarm(self, by: str = "external command") -> None:
        """Stop the motors."""
        if self.status.armed:
            self.status.armed = False
            self.compasses.store_learnt()
            self.board.say(f"Disarmed by {by}")


@dataclass(slots=True, eq=False)
class Flight:
    """Turn mode, setpoints and sticks into what the multicopter shall do."""

    board: Board
    status: Status
    store: ParameterStore
    radio: Radio
    hover: HoverGuidance
    setpoints: Setpoints
    modes: Modes
    arming: Arming

    def boot(self, hovering: bool) -> None:
        """Begin on the ground, or hovering."""
        self.setpoints.forget()
        self.hover.release()
        self.hover.height_m = None
        if hovering:
            self.hover.hold_here()

    def watch_setpoints(self) -> None:
        """Fall back to HOLD when the setpoints of OFFBOARD stay away."""
        if self.status.mode == "OFFBOARD" and self.setpoints.silent_s > self.store["COM_OF_LOSS_T"]:
            self.modes.enter("HOLD")
            self.board.say("Offboard control lost, switching to Hold", MavSeverity.CRITICAL)

    def take_setpoint(self, message: SetPositionTargetLocalNed) -> None:
        """Take a setpoint; one that sets nothing, or in an unknown frame, does not count."""
        mask = message.type_mask
        if message.coordinate_frame not in (MavFrame.LOCAL_NED, MavFrame.BODY_NED):
            return
        held = [mask & group != group for group in (Ignore.POSITION, Ignore.VELOCITY, Ignore.ACCELERATION)]
        if not any(held):
            return
        now = self.board.boot_time_s
        self.setpoints.heard()
        if self.status.mode != "OFFBOARD" or self.board.body.landed:
            return
        speed = math.hypot(message.vx, message.vy) if held[1] else 0.0
        yaw = None if mask & Ignore.YAW else message.yaw
        rate = None if mask & Ignore.YAW_RATE else message.yaw_rate
        numbers = [v for v in (speed, yaw, rate) if v is not None]
        if not all(math.isfinite(v) for v in numbers):
            return
        target = Target(now, heading_rad=yaw, rate_radps=None if yaw is not None else rate, speed_mps=speed)
        self.hover.set_target(target, math.radians(self.store["MPC_YAWRAUTO_MAX"]))

    def take_off(self, height_m: float) -> None:
        """Climb to a height above the start."""
        self.modes.enter("TAKEOFF")
        self.hover.hold()
        self.hover.height_m = height_m

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        body = self.board.body
        if not self.status.armed:
            return Drive()
        climbs = self.status.mode == "TAKEOFF" and bool(self.hover.height_m)
        if body.landed and body.climb_mps <= 0.0 and not climbs:
            if self.hover.idle(dt_s, self.status.mode, self.store["COM_DISARM_PRFLT"]):
                self.arming.disarm("auto preflight disarming")
            return Drive(motors_on=self.status.armed)
        if body.landed:
            self.hover.hold()
        now = self.board.boot_time_s
        by_hand = 0.0
        if self.status.mode in BY_HAND:
            by_hand = stick(self.radio.channel(4, now)) * math.radians(self.store["MPC_MAN_Y_MAX"])
        rate = self.hover.yaw_rate(dt_s, by_hand)
        speed = self.hover.speed_mps if self.status.mode == "OFFBOARD" else 0.0
        return Drive(rate, speed, self._climb(now), motors_on=True)

    def _climb(self, now_s: float) -> float:
        hover = self.hover
        up, down = self.store["MPC_Z_VEL_MAX_UP"], self.store["MPC_Z_VEL_MAX_DN"]
        height = self.board.body.height_m
        if self.status.mode in ("LAND", "RTL"):
            if self.status.mode == "RTL":
                hover.height_m = 0.0
            return -min(down, max(self.store["MPC_LAND_SPEED"], height / 4.0))
        if self.status.mode in BY_HAND:
            speed = stick(self.radio.channel(3, now_s))
            if speed:
                hover.height_m = height
            return speed * (up if speed > 0.0 else down) or hover.climb_rate(up, down)
        climb = hover.climb_rate(up, down)
        if self.status.mode == "TAKEOFF" and hover.height_m is not None:
            if abs(hover.height_m - height) < 0.2:
                self.modes.enter("HOLD")
        return climb
