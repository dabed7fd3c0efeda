"""PX4's arming, and why it refuses, in its words."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.enums import MavSeverity
from mavcompass.simulation.autopilot import Board, ParameterStore, Status
from mavcompass.simulation.px4.compasses import Px4Compasses


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
        reason = None if forced else self.refusal()
        if reason:
            self.board.say(reason, MavSeverity.CRITICAL)
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
