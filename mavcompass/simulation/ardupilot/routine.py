"""What ArduPilot does by itself as time goes by: texts, parameters sent unasked, yaw alignment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavcompass.enums import MavSeverity

if TYPE_CHECKING:
    from mavcompass.simulation.ardupilot.firmware import ArduPilot

_PREARM_PERIOD_S = 30.0
_STATISTICS_PERIOD_S = 30.0
_IN_FLIGHT_ALIGNMENT_M = 2.5


class Routine:
    """Attend to what is due."""

    def __init__(self, firmware: ArduPilot) -> None:
        self._fc = firmware
        self._next_prearm_s = self._next_statistics_s = self._next_second_s = 0.0
        self._told_ready = self._aligned_in_flight = False

    def boot(self, in_the_middle: bool) -> None:
        """Begin anew; in the middle of a mission everything has been said and aligned."""
        fc, now = self._fc, self._fc.vehicle.boot_time_s
        self._next_prearm_s = now + _PREARM_PERIOD_S
        self._next_statistics_s = now + _STATISTICS_PERIOD_S
        self._next_second_s = now + 1.0
        self._told_ready = self._aligned_in_flight = in_the_middle
        if not in_the_middle:
            fc.vehicle.say("ArduPilot Ready")
            steering = fc.compasses.steering
            if steering is not None:
                fc.vehicle.say(f"EKF3 IMU0 MAG{steering - 1} initial yaw alignment complete")

    def attend(self) -> None:
        """Do what is due at this tick."""
        fc, now = self._fc, self._fc.vehicle.boot_time_s
        if fc.ground.expire():
            fc.vehicle.say("target not received last 3secs, stopping", MavSeverity.WARNING)
        if not self._told_ready and fc.vehicle.ready:
            self._told_ready = True
            fc.vehicle.say("EKF3 IMU0 is using GPS")
            fc.vehicle.say("AHRS: EKF3 active")
        if now >= self._next_second_s:
            self._next_second_s += 1.0
            for progress in fc.magnetometer_calibration.progress():
                fc.vehicle.send(progress)
        if now >= self._next_statistics_s:
            self._next_statistics_s += _STATISTICS_PERIOD_S
            fc.store.set("STAT_RUNTIME", fc.store["STAT_RUNTIME"] + _STATISTICS_PERIOD_S, keep=False)
            # Nobody asked for these; a client that takes any PARAM_VALUE for its answer errs.
            fc.parameters.announce("STAT_RUNTIME")
            if not fc.armed:
                fc.parameters.announce("BARO1_GND_PRESS")
        if not fc.armed:
            self._on_the_ground(now)
        elif not self._aligned_in_flight and fc.vehicle.body.height_m > _IN_FLIGHT_ALIGNMENT_M:
            self._align_in_flight()

    def _on_the_ground(self, now: float) -> None:
        if now >= self._next_prearm_s:
            self._next_prearm_s = now + _PREARM_PERIOD_S
            self._fc.tell_refusals("PreArm")
        if self._fc.vehicle.body.landed:
            self._aligned_in_flight = False

    def _align_in_flight(self) -> None:
        """Take the compass's yaw over at once, clear of the ground and of what iron lies in it."""
        fc, body = self._fc, self._fc.vehicle.body
        self._aligned_in_flight = True
        yaw = fc.compass_yaw()
        if yaw is not None and fc.compasses.steering is not None:
            fc.vehicle.filter.align(body.roll_rad, body.pitch_rad, yaw)
            fc.hover.hold()
            fc.vehicle.say(f"EKF3 IMU0 MAG{fc.compasses.steering - 1} in-flight yaw alignment complete")
