"""How PX4 flies: setpoints in OFFBOARD, and what happens when they stop coming."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import TYPE_CHECKING

from mavcompass.enums import MavFrame, MavSeverity
from mavcompass.messages import SetPositionTargetLocalNed
from mavcompass.simulation.autopilot.guidance import HoverGuidance, Target, stick
from mavcompass.simulation.autopilot.targets import Ignore
from mavcompass.simulation.physics.motion import Drive

if TYPE_CHECKING:
    from mavcompass.simulation.px4.firmware import Px4

# Setpoints must come faster than 2 Hz to be a stream.
_SLOWEST_SETPOINTS_S = 0.5
_LANDED_AND_IDLE_S = 2.0


class Flight:
    """Turn mode, setpoints and sticks into what the multicopter shall do."""

    def __init__(self, firmware: Px4) -> None:
        self._fc = firmware
        self._hover = HoverGuidance(firmware.vehicle)
        self._heard_s: deque[float] = deque(maxlen=3)
        self._idle_s = 0.0

    def boot(self, hovering: bool) -> None:
        """Begin on the ground, or hovering."""
        self._heard_s.clear()
        self._hover.release()
        self._hover.height_m = self._fc.vehicle.body.height_m if hovering else None
        if hovering:
            self._hover.hold()

    def mode_changed(self) -> None:
        """Hold heading and height on entering a mode."""
        if not self._fc.vehicle.body.landed:
            self._hover.hold()
            self._hover.height_m = self._fc.vehicle.body.height_m

    @property
    def setpoints_flow(self) -> bool:
        """Tell whether setpoints have come, and come, as a stream."""
        heard, now = self._heard_s, self._fc.vehicle.boot_time_s
        gaps = [b - a for a, b in pairwise((*heard, now))]
        return len(heard) == heard.maxlen and max(gaps) <= _SLOWEST_SETPOINTS_S

    def watch_setpoints(self) -> None:
        """Fall back to HOLD when the setpoints of OFFBOARD stay away."""
        fc = self._fc
        if fc.mode != "OFFBOARD":
            return
        silent_s = fc.vehicle.boot_time_s - self._heard_s[-1] if self._heard_s else math.inf
        if silent_s > fc.store["COM_OF_LOSS_T"]:
            fc.set_mode("HOLD")
            fc.vehicle.say("Offboard control lost, switching to Hold", MavSeverity.CRITICAL)

    def take_setpoint(self, message: SetPositionTargetLocalNed) -> None:
        """Take a setpoint; one that sets nothing, or in an unknown frame, does not count."""
        fc, mask = self._fc, message.type_mask
        if message.coordinate_frame not in (MavFrame.LOCAL_NED, MavFrame.BODY_NED):
            return
        held = [mask & group != group for group in (Ignore.POSITION, Ignore.VELOCITY, Ignore.ACCELERATION)]
        if not any(held):
            return
        now = fc.vehicle.boot_time_s
        self._heard_s.append(now)
        if fc.mode != "OFFBOARD" or fc.vehicle.body.landed:
            return
        speed = math.hypot(message.vx, message.vy) if held[1] else 0.0
        yaw = None if mask & Ignore.YAW else message.yaw
        rate = None if mask & Ignore.YAW_RATE else message.yaw_rate
        numbers = [v for v in (speed, yaw, rate) if v is not None]
        if not all(math.isfinite(v) for v in numbers):
            return
        target = Target(now, heading_rad=yaw, rate_radps=None if yaw is not None else rate, speed_mps=speed)
        self._hover.set_target(target, math.radians(fc.store["MPC_YAWRAUTO_MAX"]))

    def take_off(self, height_m: float) -> None:
        """Climb to a height above the start."""
        self._fc.set_mode("TAKEOFF")
        self._hover.hold()
        self._hover.height_m = height_m

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        fc, body = self._fc, self._fc.vehicle.body
        if not fc.armed:
            return Drive()
        climbs = fc.mode == "TAKEOFF" and bool(self._hover.height_m)
        if body.landed and body.climb_mps <= 0.0 and not climbs:
            return self._idle(dt_s)
        self._idle_s = 0.0
        if body.landed:
            self._hover.hold()
        now = fc.vehicle.boot_time_s
        by_hand = 0.0
        if fc.mode in ("POSCTL", "ALTCTL", "MANUAL", "STABILIZED", "ACRO"):
            by_hand = stick(fc.radio.channel(4, now)) * math.radians(fc.store["MPC_MAN_Y_MAX"])
        rate = self._hover.yaw_rate(dt_s, by_hand)
        speed = self._hover.speed_mps if fc.mode == "OFFBOARD" else 0.0
        return Drive(rate, speed, self._climb(now), motors_on=True)

    def _climb(self, now_s: float) -> float:
        fc, hover = self._fc, self._hover
        up, down = fc.store["MPC_Z_VEL_MAX_UP"], fc.store["MPC_Z_VEL_MAX_DN"]
        height = fc.vehicle.body.height_m
        if fc.mode == "LAND":
            return -min(down, max(fc.store["MPC_LAND_SPEED"], height / 4.0))
        if fc.mode == "RTL":
            hover.height_m = 0.0
            return -min(down, max(fc.store["MPC_LAND_SPEED"], height / 4.0))
        if fc.mode in ("POSCTL", "ALTCTL", "MANUAL", "STABILIZED", "ACRO"):
            speed = stick(fc.radio.channel(3, now_s))
            if speed:
                hover.height_m = height
            return speed * (up if speed > 0.0 else down) or hover.climb_rate(up, down)
        climb = hover.climb_rate(up, down)
        if fc.mode == "TAKEOFF" and hover.height_m is not None and abs(hover.height_m - height) < 0.2:
            fc.set_mode("HOLD")
        return climb

    def _idle(self, dt_s: float) -> Drive:
        """Stand on the ground with the motors idling; disarm after a while."""
        fc = self._fc
        self._hover.release()
        self._hover.height_m = None
        self._idle_s += dt_s
        limit = _LANDED_AND_IDLE_S if fc.mode in ("LAND", "RTL") else fc.store["COM_DISARM_PRFLT"]
        if self._idle_s >= limit:
            self._idle_s = 0.0
            fc.armed = False
            fc.vehicle.say("Disarmed by auto preflight disarming")
        return Drive(motors_on=fc.armed)
