"""ArduPilot's answers to COMMAND_LONG: one function per command, each returning the MAV_RESULT."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from mavcompass.compass_parameters import ardupilot_name
from mavcompass.correction import Vector
from mavcompass.enums import MavCmd, MavResult
from mavcompass.messages import CommandLong
from mavcompass.simulation.ardupilot.compasses import INSTANCES
from mavcompass.simulation.autopilot.firmware import Sender
from mavcompass.simulation.autopilot.stream_commands import answer_stream_command
from mavcompass.simulation.physics.motion import rotation_matrix

if TYPE_CHECKING:
    from mavcompass.simulation.ardupilot.firmware import ArduPilot

Handler = Callable[["ArduPilot", CommandLong, Sender], MavResult]

_FORCE = 21196.0
_FORCE_SAVE_CALIBRATION = 76.0
_SENSOR_OF_COMPASS = {2: 1, 5: 2, 6: 3}
_DEFAULT_SLEW_RADPS = math.radians(60.0)
_TAKEOFF_MIN_M = 0.1


def _arm_disarm(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    forced = c.param2 == _FORCE
    if c.param1 not in (0.0, 1.0):
        return MavResult.UNSUPPORTED
    if c.param1 == 1.0:
        return _as_result(fc.armed or fc.arm(forced))
    flying = fc.vehicle.profile.hover_m > 0.0 and not fc.vehicle.body.landed
    if fc.armed and flying and not forced:
        return MavResult.FAILED
    fc.disarm()
    return MavResult.ACCEPTED


def _set_mode(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if not int(c.param1) & 1:
        return MavResult.DENIED
    return _as_result(fc.set_mode_number(int(c.param2)))


def _condition_yaw(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if not fc.vehicle.profile.hovers:
        return MavResult.UNSUPPORTED
    if not 0.0 <= c.param1 <= 360.0 or c.param4 not in (0.0, 1.0):
        return MavResult.FAILED
    # Accepted in any mode and on the ground; it moves only where auto-yaw is in charge.
    if fc.armed and fc.mode == "GUIDED" and not fc.vehicle.body.landed:
        slew = math.radians(c.param2) if c.param2 > 0.0 else _DEFAULT_SLEW_RADPS
        direction = int(math.copysign(1.0, c.param3)) if c.param3 else 0
        fc.hover.turn(math.radians(c.param1), slew, direction, relative=c.param4 == 1.0)
    return MavResult.ACCEPTED


def _takeoff(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.vehicle.profile.chassis != "copter":
        return MavResult.UNSUPPORTED
    if not fc.armed or fc.mode != "GUIDED" or c.param7 < _TAKEOFF_MIN_M:
        return MavResult.FAILED
    fc.hover.hold()
    fc.hover.height_m = c.param7
    return MavResult.ACCEPTED


def _land(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.vehicle.profile.chassis != "copter":
        return MavResult.UNSUPPORTED
    return _as_result(fc.set_mode("LAND"))


def _reboot(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if c.param1 not in (1.0, 3.0):
        return MavResult.UNSUPPORTED
    if fc.armed:
        return MavResult.FAILED
    fc.reboot_wanted = True
    return MavResult.ACCEPTED


def _run_checks(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.armed:
        return MavResult.TEMPORARILY_REJECTED
    fc.tell_refusals("PreArm")
    return MavResult.ACCEPTED


def _preflight_calibration(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.armed:
        return MavResult.DENIED
    if c.param2 != _FORCE_SAVE_CALIBRATION:
        return MavResult.UNSUPPORTED
    for instance in INSTANCES:
        save_device_id(fc, instance)
    return MavResult.ACCEPTED


def _set_sensor_offsets(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.armed:
        return MavResult.FAILED
    instance = _SENSOR_OF_COMPASS.get(int(c.param1))
    if instance is None:
        return MavResult.UNSUPPORTED
    write_vector(fc, "OFS", instance, (c.param2, c.param3, c.param4))
    save_device_id(fc, instance)
    return MavResult.ACCEPTED


def _fixed_yaw_calibration(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    """Set offsets from one reading and a known true yaw; diagonals become 1 (and the scale is forgotten).

    Compasses that COMPASS_USE turns off are passed over, with the same answer.
    """
    vehicle, bank = fc.vehicle, fc.compasses
    if not vehicle.ready:
        return MavResult.FAILED
    mask = int(c.param2)
    m = rotation_matrix(vehicle.filter.roll_rad, vehicle.filter.pitch_rad, math.radians(c.param1))
    n, e, d = vehicle.world.field_ned_mgauss
    expected = tuple(m[i] * n + m[3 + i] * e + m[6 + i] * d for i in range(3))
    for bit, instance in enumerate(INSTANCES):
        if bank.in_use(instance) and (not mask or mask & (1 << bit)):
            raw = bank.uncorrected(instance)
            x, y, z = (want - have for want, have in zip(expected, raw, strict=True))
            write_vector(fc, "OFS", instance, (x, y, z))
            write_vector(fc, "DIA", instance, (1.0, 1.0, 1.0))
            write_vector(fc, "ODI", instance, (0.0, 0.0, 0.0))
            save_device_id(fc, instance)
    return MavResult.ACCEPTED


def _start_magnetometer_calibration(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    if fc.armed:
        return MavResult.FAILED
    fc.magnetometer_calibration.start(int(c.param1))
    return MavResult.ACCEPTED


def _accept_magnetometer_calibration(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    # It cannot succeed here: a vehicle on level ground never shows the field from all sides.
    return MavResult.FAILED


def _cancel_magnetometer_calibration(fc: ArduPilot, c: CommandLong, sender: Sender) -> MavResult:
    fc.magnetometer_calibration.cancel()
    return MavResult.ACCEPTED


def write_vector(fc: ArduPilot, stem: str, instance: int, values: Vector) -> None:
    """Store a compass vector and send it to every station, as a save by the firmware itself does."""
    for axis, value in zip("XYZ", values, strict=True):
        name = ardupilot_name(f"{stem}_{axis}", instance)
        if fc.store.set(name, value):
            fc.parameters.announce(name)
    fc.compasses.parameters_changed()


def save_device_id(fc: ArduPilot, instance: int) -> None:
    """Store the id of the compass's hardware, which makes it count as calibrated."""
    name = ardupilot_name("DEV_ID", instance)
    fc.store.set(name, fc.compasses.hardware_ids[instance - 1])


def _as_result(done: bool) -> MavResult:
    return MavResult.ACCEPTED if done else MavResult.FAILED


_HANDLERS: dict[int, Handler] = {
    MavCmd.COMPONENT_ARM_DISARM: _arm_disarm,
    MavCmd.DO_SET_MODE: _set_mode,
    MavCmd.CONDITION_YAW: _condition_yaw,
    MavCmd.NAV_TAKEOFF: _takeoff,
    MavCmd.NAV_LAND: _land,
    MavCmd.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    MavCmd.RUN_PREARM_CHECKS: _run_checks,
    MavCmd.PREFLIGHT_CALIBRATION: _preflight_calibration,
    MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS: _set_sensor_offsets,
    MavCmd.FIXED_MAG_CAL_YAW: _fixed_yaw_calibration,
    MavCmd.DO_START_MAG_CAL: _start_magnetometer_calibration,
    MavCmd.DO_ACCEPT_MAG_CAL: _accept_magnetometer_calibration,
    MavCmd.DO_CANCEL_MAG_CAL: _cancel_magnetometer_calibration,
}


def answer_command(fc: ArduPilot, command: CommandLong, sender: Sender) -> MavResult:
    """Carry out a command; what this firmware does not know is UNSUPPORTED."""
    values = (command.param1, command.param2, command.param3, command.param4, command.param7)
    if not all(math.isfinite(v) for v in values):
        return MavResult.DENIED
    about_messages = answer_stream_command(fc.vehicle, command, sender)
    if about_messages is not None:
        return about_messages
    handler = _HANDLERS.get(command.command)
    return MavResult.UNSUPPORTED if handler is None else handler(fc, command, sender)
