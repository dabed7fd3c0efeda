"""How PX4 flies: setpoints in OFFBOARD, and what happens when they stop coming."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.enums import MavFrame, MavSeverity
from mavcompass.messages import SetPositionTargetLocalNed
from mavcompass.simulation.autopilot import (
    Board,
    HoverGuidance,
    Ignore,
    ParameterStore,
    Radio,
    Status,
    Target,
    stick,
)
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.px4.arming import Arming
from mavcompass.simulation.px4.modes import BY_HAND, Modes
from mavcompass.simulation.px4.setpoints import Setpoints


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
