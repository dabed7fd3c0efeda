"""ArduPilot's arming, and why it refuses: the checks of position and compasses, in its words."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.compass_parameters import ardupilot_name
from mavcompass.correction import Vector
from mavcompass.enums import MavSeverity
from mavcompass.simulation.ardupilot.compasses import INSTANCES, CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.ardupilot.modes import ModeRules
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import HoverGuidance
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.physics.motion import rotation_matrix, times

_CHECK_ALL, _CHECK_COMPASS, _CHECK_INS = 1, 4, 16
_ACCELEROMETERS_SETTLE_S = 3.0
# Limits of the firmware: field length, and how far compasses may disagree.
_FIELD_MGAUSS = (185, 875)
_APART_3D_RAD, _APART_XY_RAD, _APART_XY_MGAUSS = math.radians(90.0), math.radians(60.0), 200.0


@dataclass(slots=True, eq=False)
class Arming:
    """Arm and disarm; say why not."""

    board: Board
    status: Status
    store: ParameterStore
    rules: ModeRules
    compasses: CompassBank
    calibration: MagnetometerCalibration
    hover: HoverGuidance

    def arm(self, forced: bool) -> bool:
        """Arm if nothing speaks against it, or forced."""
        if not forced and self.tell_refusals("Arm"):
            return False
        self.status.armed = True
        profile = self.board.profile
        self.board.say("Arming motors" if profile.hovers else "Throttle armed")
        if profile.chassis == "sub":
            self.hover.hold_here()
        return True

    def disarm(self) -> None:
        """Stop the motors."""
        if self.status.armed:
            self.status.armed = False
            self.hover.release()
            self.board.say("Disarming motors" if self.board.profile.hovers else "Throttle disarmed")

    def tell_refusals(self, prefix: str) -> bool:
        """Send why it will not arm, every reason; True where there is one."""
        reasons = self.refusals()
        for reason in reasons:
            self.board.say(f"{prefix}: {reason}", MavSeverity.CRITICAL)
        return bool(reasons)

    def refusals(self) -> list[str]:
        """List the reasons against arming now, the first of which is told; empty when it may arm."""
        reasons = []
        if self.compasses.bad_rotation:
            reasons.append("Internal errors 0x400000 l:0 bad_rotation")
        if self.calibration.running:
            reasons.append("Compass calibration running")
        elif self.calibration.reboot_wanted:
            reasons.append("Compass calibrated requires reboot")
        checks = int(self.store.get("ARMING_CHECK", 1.0))
        if checks & (_CHECK_ALL | _CHECK_INS) and self.board.boot_time_s < _ACCELEROMETERS_SETTLE_S:
            reasons.append("Accels inconsistent")
        if not self.board.ready:
            if self.board.profile.hovers:
                reasons.append("AHRS: EK3 sources require GPS")
            if self.status.mode in self.rules.need_position:
                reasons.append("Need Position Estimate")
        if checks & (_CHECK_ALL | _CHECK_COMPASS) and self.store.get("COMPASS_ENABLE", 1.0):
            reasons += self._compass_refusals()
        if self.status.mode in self.rules.cannot_arm:
            reasons.append(f"{self.status.mode.title()} mode not armable")
        return reasons

    def _compass_refusals(self) -> list[str]:
        bank, store = self.compasses, self.store
        used = [i for i in bank.order if bank.in_use(i)]
        if not used:
            return []
        first = used[0]
        if not bank.healthy(first):
            return ["Compass not healthy"]
        if not all(self._configured(i) for i in used):
            return ["Compass not calibrated"]
        limit = store.get("COMPASS_OFFS_MAX", 1800.0)
        if any(math.hypot(*bank.correction(i).offsets_mgauss) > limit for i in used):
            return ["Compass offsets too high"]
        field = bank.field(first)
        length = math.hypot(*field)
        low, high = _FIELD_MGAUSS
        if not low <= length <= high:
            return [f"Check mag field: {length:.0f}, max {high}, min {low}"]
        if any(_inconsistent(field, bank.field(i)) for i in used[1:]):
            return ["Compasses inconsistent"]
        return self._against_world(field)

    def _configured(self, instance: int) -> bool:
        """Tell whether a compass counts as calibrated: some offset, and the saved id is the hardware's."""
        bank = self.compasses
        saved = self.store.get(ardupilot_name("DEV_ID", instance))
        same = saved == bank.hardware_ids[INSTANCES.index(instance)]
        return same and any(bank.correction(instance).offsets_mgauss)

    def _against_world(self, field: Vector) -> list[str]:
        """Compare with the world model, turned by the filter's own yaw (so a pure yaw error passes)."""
        threshold = self.store.get("ARMING_MAGTHRESH", 100.0)
        if threshold <= 0.0 or not self.board.ready:
            return []
        estimate, world = self.board.filter, self.board.world.field_ned_mgauss
        attitude = rotation_matrix(estimate.roll_rad, estimate.pitch_rad, estimate.yaw_rad)
        north, east, down = (a - b for a, b in zip(times(attitude, field), world, strict=True))
        across = math.hypot(north, east)
        if across > threshold:
            return [f"Check mag field (xy diff:{across:.0f}>{threshold:.0f})"]
        if abs(down) > 2.0 * threshold:
            return [f"Check mag field (z diff:{abs(down):.0f}>{2.0 * threshold:.0f})"]
        return []


def _inconsistent(a: Vector, b: Vector) -> bool:
    def apart(u: tuple[float, ...], v: tuple[float, ...]) -> float:
        lengths = math.hypot(*u) * math.hypot(*v)
        cosine = sum(i * j for i, j in zip(u, v, strict=True)) / lengths if lengths else 1.0
        return math.acos(max(-1.0, min(1.0, cosine)))

    return (
        apart(a, b) > _APART_3D_RAD
        or apart(a[:2], b[:2]) > _APART_XY_RAD
        or abs(math.hypot(*a[:2]) - math.hypot(*b[:2])) > _APART_XY_MGAUSS
        or math.hypot(a[0] - b[0], a[1] - b[1]) > _APART_XY_MGAUSS
    )
