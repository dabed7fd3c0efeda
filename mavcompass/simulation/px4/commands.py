"""PX4's answers to COMMAND_LONG."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mavcompass.compass_parameters import px4_name
from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import CommandLong
from mavcompass.simulation.autopilot.firmware import Sender
from mavcompass.simulation.autopilot.stream_commands import answer_stream_command, whole
from mavcompass.simulation.physics.motion import rotation_matrix
from mavcompass.simulation.px4 import modes
from mavcompass.simulation.px4.compasses import INSTANCES
from mavcompass.units import MGAUSS_PER_GAUSS

if TYPE_CHECKING:
    from mavcompass.simulation.px4.firmware import Px4

_FORCE = 21196.0


def answer_command(fc: Px4, command: CommandLong, sender: Sender) -> MavResult:
    """Carry out a command; what this firmware does not know, CONDITION_YAW too, is UNSUPPORTED."""
    about_messages = answer_stream_command(fc.vehicle, command, sender)
    if about_messages is not None:
        return about_messages
    match command.command:
        case MavCmd.COMPONENT_ARM_DISARM:
            return _arm_disarm(fc, command)
        case MavCmd.DO_SET_MODE:
            mode = modes.mode_of(whole(command.param2), whole(command.param3))
            return _or_rejected(bool(whole(command.param1) & 1) and fc.set_mode(mode))
        case MavCmd.NAV_TAKEOFF:
            return _take_off(fc, command)
        case MavCmd.NAV_LAND:
            return _or_rejected(fc.set_mode("LAND"))
        case MavCmd.PREFLIGHT_REBOOT_SHUTDOWN if command.param1 in (1.0, 3.0):
            if fc.armed:
                return MavResult.DENIED
            fc.reboot_wanted = True
            return MavResult.ACCEPTED
        case MavCmd.RUN_PREARM_CHECKS:
            if reason := fc.refusal():
                fc.vehicle.say(reason)
            return MavResult.ACCEPTED
        case MavCmd.FIXED_MAG_CAL_YAW:
            return _fixed_yaw_calibration(fc, command)
        case _:
            return MavResult.UNSUPPORTED


def _or_rejected(done: bool) -> MavResult:
    return MavResult.ACCEPTED if done else MavResult.TEMPORARILY_REJECTED


def _arm_disarm(fc: Px4, command: CommandLong) -> MavResult:
    forced = command.param2 == _FORCE
    if command.param1 == 1.0:
        return _or_rejected(fc.armed or fc.arm(forced))
    if command.param1 != 0.0:
        return MavResult.UNSUPPORTED
    if fc.armed and not fc.vehicle.body.landed and not forced:
        return MavResult.DENIED
    fc.disarm()
    return MavResult.ACCEPTED


def _take_off(fc: Px4, command: CommandLong) -> MavResult:
    if not fc.armed or not fc.vehicle.ready:
        return MavResult.DENIED
    height = command.param7 - fc.vehicle.world.place.alt_m
    if not math.isfinite(height) or height <= 0.0:
        height = fc.store["MIS_TAKEOFF_ALT"]
    fc.flight.take_off(height)
    return MavResult.ACCEPTED


def _fixed_yaw_calibration(fc: Px4, command: CommandLong) -> MavResult:
    """Set offsets from one reading and a known true yaw (NaN: north; rounded to whole degrees).

    Works disarmed only. The place is the vehicle's own unless latitude and longitude are both given;
    the simulated vehicle takes its own in any case.
    """
    if fc.armed:
        return MavResult.DENIED
    yaw_deg = 0.0 if math.isnan(command.param1) else float(round(command.param1))
    estimate = fc.vehicle.filter
    m = rotation_matrix(estimate.roll_rad, estimate.pitch_rad, math.radians(yaw_deg))
    n, e, d = fc.vehicle.world.field_ned_mgauss
    expected = [m[i] * n + m[3 + i] * e + m[6 + i] * d for i in range(3)]
    for instance in INSTANCES:
        in_sensor = fc.compasses.expected_raw(instance, expected)
        raw = fc.compasses.raw_sensor_mgauss[instance - 1]
        for axis, have, want in zip("XYZ", raw, in_sensor, strict=True):
            name = px4_name(f"{axis}OFF", instance)
            fc.store.set(name, (have - want) / MGAUSS_PER_GAUSS)
            fc.parameters.announce(name)
    fc.compasses.parameters_changed()
    return MavResult.ACCEPTED
