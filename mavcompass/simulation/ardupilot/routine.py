"""What ArduPilot does by itself as time goes by: texts, parameters sent unasked, yaw alignment."""

from __future__ import annotations

from dataclasses import dataclass, field

from mavcompass.enums import MavSeverity
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.compasses import CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.autopilot import Board, GroundGuidance, HoverGuidance, ParameterServer, Status

_PREARM_PERIOD_S = 30.0
_STATISTICS_PERIOD_S = 30.0
_IN_FLIGHT_ALIGNMENT_M = 2.5


@dataclass(slots=True, eq=False)
class Routine:
    """Attend to what is due."""

    board: Board
    status: Status
    parameters: ParameterServer
    compasses: CompassBank
    calibration: MagnetometerCalibration
    ground: GroundGuidance
    hover: HoverGuidance
    arming: Arming
    _next_prearm_s: float = field(default=0.0, init=False)
    _next_statistics_s: float = field(default=0.0, init=False)
    _next_second_s: float = field(default=0.0, init=False)
    _told_ready: bool = field(default=False, init=False)
    _aligned_in_flight: bool = field(default=False, init=False)

    def boot(self, in_the_middle: bool) -> None:
        """Begin anew; in the middle of a mission everything has been said and aligned."""
        now = self.board.boot_time_s
        self._next_prearm_s = now + _PREARM_PERIOD_S
        self._next_statistics_s = now + _STATISTICS_PERIOD_S
        self._next_second_s = now + 1.0
        self._told_ready = self._aligned_in_flight = in_the_middle
        if not in_the_middle:
            self.board.say("ArduPilot Ready")
            steering = self.compasses.steering
            if steering is not None:
                self.board.say(f"EKF3 IMU0 MAG{steering - 1} initial yaw alignment complete")

    def attend(self) -> None:
        """Do what is due at this tick."""
        now = self.board.boot_time_s
        if self.ground.expire():
            self.board.say("target not received last 3secs, stopping", MavSeverity.WARNING)
        if not self._told_ready and self.board.ready:
            self._told_ready = True
            self.board.say("EKF3 IMU0 is using GPS")
            self.board.say("AHRS: EKF3 active")
        if now >= self._next_second_s:
            self._next_second_s += 1.0
            for progress in self.calibration.reports():
                self.board.send(progress)
        if now >= self._next_statistics_s:
            self._next_statistics_s += _STATISTICS_PERIOD_S
            store = self.parameters.store
            store.set("STAT_RUNTIME", store["STAT_RUNTIME"] + _STATISTICS_PERIOD_S, keep=False)
            # Nobody asked for these; a client that takes any PARAM_VALUE for its answer errs.
            self.parameters.announce("STAT_RUNTIME")
            if not self.status.armed:
                self.parameters.announce("BARO1_GND_PRESS")
        if not self.status.armed:
            self._on_the_ground(now)
        elif not self._aligned_in_flight and self.board.body.height_m > _IN_FLIGHT_ALIGNMENT_M:
            self._align_in_flight()

    def _on_the_ground(self, now: float) -> None:
        if now >= self._next_prearm_s:
            self._next_prearm_s = now + _PREARM_PERIOD_S
            self.arming.tell_refusals("PreArm")
        if self.board.body.landed:
            self._aligned_in_flight = False

    def _align_in_flight(self) -> None:
        """Take the compass's yaw over at once, clear of the ground and of what iron lies in it."""
        body = self.board.body
        self._aligned_in_flight = True
        yaw = self.compasses.yaw()
        if yaw is not None and self.compasses.steering is not None:
            self.board.filter.align(body.roll_rad, body.pitch_rad, yaw)
            self.hover.hold()
            self.board.say(f"EKF3 IMU0 MAG{self.compasses.steering - 1} in-flight yaw alignment complete")
