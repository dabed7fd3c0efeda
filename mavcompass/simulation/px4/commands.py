"""PX4's answers to COMMAND_LONG."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mavcompass.compass_parameters import px4_name
from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import CommandLong
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.parameters import ParameterServer
from mavcompass.simulation.autopilot.telemetry import FORCE, Telemetry, whole
from mavcompass.simulation.px4.compasses import INSTANCES, Px4Compasses
from mavcompass.simulation.px4.flight import Arming, Flight, Modes, mode_of
from mavcompass.simulation.px4.magnetometer_calibration import MagnetometerCalibration
from mavcompass.units import MGAUSS_PER_GAUSS


@dataclass(slots=True, eq=False)
class Commands:
    """Carry commands out."""

    board: Board
    status: Status
    modes: Modes
    arming: Arming
    flight: Flight
    compasses: Px4Compasses
    calibration: MagnetometerCalibration
    parameters: ParameterServer
    telemetry: Telemetry

    def answer(self, command: CommandLong, port: int) -> MavResult:
        """Carry out a command; what this firmware does not know, CONDITION_YAW too, is UNSUPPORTED."""
        about_messages = self.telemetry.answer(command, port)
        if about_messages is not None:
            return about_messages
        match command.command:
            case MavCmd.COMPONENT_ARM_DISARM:
                return self._arm_disarm(command)
            case MavCmd.DO_SET_MODE:
                mode = mode_of(whole(command.param2), whole(command.param3))
                return _or_rejected(bool(whole(command.param1) & 1) and self.modes.enter(mode))
            case MavCmd.NAV_TAKEOFF:
                return self._take_off(command)
            case MavCmd.NAV_LAND:
                return _or_rejected(self.modes.enter("LAND"))
            case MavCmd.PREFLIGHT_REBOOT_SHUTDOWN if command.param1 in (1.0, 3.0):
                if self.status.armed:
                    return MavResult.DENIED
                self.status.reboot_wanted = True
                return MavResult.ACCEPTED
            case MavCmd.RUN_PREARM_CHECKS:
                if reason := self.arming.refusal():
                    self.board.say(reason)
                return MavResult.ACCEPTED
            case MavCmd.PREFLIGHT_CALIBRATION:
                return self._preflight_calibration(command)
            case MavCmd.FIXED_MAG_CAL_YAW:
                return self._fixed_yaw_calibration(command)
            case _:
                return MavResult.UNSUPPORTED

    def _arm_disarm(self, command: CommandLong) -> MavResult:
        forced = command.param2 == FORCE
        if command.param1 == 1.0:
            return _or_rejected(self.status.armed or self.arming.arm(forced))
        if command.param1 != 0.0:
            return MavResult.UNSUPPORTED
        if self.status.armed and not self.board.body.landed and not forced:
            return MavResult.DENIED
        self.arming.disarm()
        return MavResult.ACCEPTED

    def _take_off(self, command: CommandLong) -> MavResult:
        if not self.status.armed or not self.board.ready:
            return MavResult.DENIED
        height = command.param7 - self.board.world.place.alt_m
        if not math.isfinite(height) or height <= 0.0:
            height = self.parameters.store["MIS_TAKEOFF_ALT"]
        self.flight.take_off(height)
        return MavResult.ACCEPTED

    def _preflight_calibration(self, command: CommandLong) -> MavResult:
        """Begin the magnetometer's, with p2 = 1; all zeros cancel it."""
        if self.calibration.running:
            if any((command.param1, command.param2, command.param3, command.param5, command.param6)):
                return MavResult.DENIED
            self.calibration.cancel()
            return MavResult.ACCEPTED
        if self.status.armed:
            return MavResult.TEMPORARILY_REJECTED
        if command.param2 == 1.0:
            self.calibration.start(len(INSTANCES))
        return MavResult.ACCEPTED if command.param2 in (0.0, 1.0) else MavResult.UNSUPPORTED

    def _fixed_yaw_calibration(self, command: CommandLong) -> MavResult:
        """Set offsets from one reading and a known true yaw (NaN: north; rounded to whole degrees).

        Works disarmed only. The place is the vehicle's own unless latitude and longitude are both given;
        the simulated vehicle takes its own in any case.
        """
        if self.status.armed:
            return MavResult.DENIED
        yaw_deg = 0.0 if math.isnan(command.param1) else float(round(command.param1))
        expected = self.compasses.expected_field(math.radians(yaw_deg))
        for instance in INSTANCES:
            in_sensor = self.compasses.expected_raw(instance, expected)
            raw = self.compasses.raw_sensor_mgauss[instance - 1]
            for axis, have, want in zip("XYZ", raw, in_sensor, strict=True):
                name = px4_name(f"{axis}OFF", instance)
                self.parameters.store.set(name, (have - want) / MGAUSS_PER_GAUSS)
                self.parameters.announce(name)
        self.compasses.parameters_changed()
        return MavResult.ACCEPTED


def _or_rejected(done: bool) -> MavResult:
    return MavResult.ACCEPTED if done else MavResult.TEMPORARILY_REJECTED
