"""ArduPilot's answers to COMMAND_LONG: one method per command, each returning the MAV_RESULT.

Before them the sets of sources of its estimator (EK3_SRCn_*): which is in use, and what a switch does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from mavcompass import messages as m
from mavcompass.compass_parameters import ardupilot_name
from mavcompass.correction import Vector
from mavcompass.enums import MavCmd, MavResult
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.compasses import INSTANCES, CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.ardupilot.modes import Modes
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import HoverGuidance
from mavcompass.simulation.autopilot.parameters import ParameterServer, ParameterStore
from mavcompass.simulation.autopilot.telemetry import FORCE, Telemetry

_SETS = (1, 2, 3)
_COMPASS, _COMPASS_AS_FALLBACK = 1.0, 3.0
_HEADING_ONLY = 2.0  # EK3_MAG_CAL
_SUREST_READING = 0.2  # of what is shipped; less is not taken of a field's, nor ever set of a heading's


class Sources:
    """Choose a set of sources; the choice is forgotten at a restart.

    Seen on ArduPilot 4.5.7: when the compass becomes the source of yaw, its yaw is taken over at once; a
    flying copter goes back within a second to what its filter has learnt of the field.

    Attributes:
        compasses_aside: the filter follows no compass until the next start, whatever its sources are.
    """

    def __init__(self, board: Board, store: ParameterStore) -> None:
        self._board = board
        self._store = store
        self.boot()

    def boot(self) -> None:
        """Use the first set."""
        self.number = 1
        self.compasses_aside = False
        self._followed = True

    def use(self, number: int) -> bool:
        """Use another set; False where there is no such set."""
        if number not in _SETS:
            return False
        self.number = number
        return True

    def correct(self, dt_s: float, compass_yaw_rad: float | None) -> None:
        """Let the filter follow the compass, where that is its source of yaw."""
        # A submarine does not climb, which is what the filter begins to learn the field at (EK3_MAG_CAL 3).
        estimate = self._board.filter
        flying = self._board.profile.chassis == "copter" and not self._board.body.landed
        named = self._store.get(f"EK3_SRC{self.number}_YAW", 1.0) in (_COMPASS, _COMPASS_AS_FALLBACK)
        follows = named and not self.compasses_aside
        if follows and not self._followed and compass_yaw_rad is not None and not flying:
            estimate.take_yaw(compass_yaw_rad)
        learns = flying and self._store["EK3_MAG_CAL"] != _HEADING_ONLY
        within_rad = self._learns_within_rad() if learns else 0.0
        noises = self._noises("EK3_MAG_M_NSE" if learns else "EK3_YAW_M_NSE")
        estimate.correct(dt_s, compass_yaw_rad if follows else None, within_rad, *noises)
        self._followed = follows

    def _learns_within_rad(self) -> float:
        """Return how far the direction of the field may be learnt to be off the world model's."""
        return math.asin(min(1.0, self._store["EK3_MAG_EF_LIM"] / self._board.world.horizontal_mgauss))

    def _noises(self, reading: str) -> tuple[float, float]:
        """Return how much surer a reading counts than as shipped, and how much more the bias may wander."""
        store = self._store
        less, more = (store[name] / store.factory_value(name) for name in (reading, "EK3_GBIAS_P_NSE"))
        return 1.0 / max(less, _SUREST_READING), more


_FORCE_SAVE_CALIBRATION = 76.0
_SENSOR_OF_COMPASS = {2: 1, 5: 2, 6: 3}
_DEFAULT_SLEW_RADPS = math.radians(60.0)
_TAKEOFF_MIN_M = 0.1


@dataclass(slots=True, eq=False)
class Commands:
    """Carry commands out."""

    board: Board
    status: Status
    modes: Modes
    arming: Arming
    hover: HoverGuidance
    compasses: CompassBank
    calibration: MagnetometerCalibration
    sources: Sources
    parameters: ParameterServer
    telemetry: Telemetry

    def answer(self, command: m.CommandLong, port: int) -> MavResult:
        """Carry out a command; what this firmware does not know is UNSUPPORTED."""
        values = (command.param1, command.param2, command.param3, command.param4, command.param7)
        if not all(math.isfinite(v) for v in values):
            return MavResult.DENIED
        about_messages = self.telemetry.answer(command, port)
        if about_messages is not None:
            return about_messages
        handler = self._handler(command.command)
        return MavResult.UNSUPPORTED if handler is None else handler(command)

    def _handler(self, command: int) -> Callable[[m.CommandLong], MavResult] | None:
        handlers: dict[int, Callable[[m.CommandLong], MavResult]] = {
            MavCmd.COMPONENT_ARM_DISARM: self._arm_disarm,
            MavCmd.DO_SET_MODE: self._set_mode,
            MavCmd.CONDITION_YAW: self._condition_yaw,
            MavCmd.NAV_TAKEOFF: self._takeoff,
            MavCmd.NAV_LAND: self._land,
            MavCmd.PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            MavCmd.RUN_PREARM_CHECKS: self._run_checks,
            MavCmd.PREFLIGHT_CALIBRATION: self._preflight_calibration,
            MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS: self._set_sensor_offsets,
            MavCmd.FIXED_MAG_CAL_YAW: self._fixed_yaw_calibration,
            MavCmd.SET_EKF_SOURCE_SET: self._use_sources,
            MavCmd.DO_START_MAG_CAL: self._start_magnetometer_calibration,
            MavCmd.DO_ACCEPT_MAG_CAL: self._accept_magnetometer_calibration,
            MavCmd.DO_CANCEL_MAG_CAL: self._cancel_magnetometer_calibration,
        }
        return handlers.get(command)

    def _arm_disarm(self, c: m.CommandLong) -> MavResult:
        forced = c.param2 == FORCE
        if c.param1 not in (0.0, 1.0):
            return MavResult.UNSUPPORTED
        if c.param1 == 1.0:
            return _as_result(self.status.armed or self.arming.arm(forced))
        flying = self.board.profile.hover_m > 0.0 and not self.board.body.landed
        if self.status.armed and flying and not forced:
            return MavResult.FAILED
        self.arming.disarm()
        return MavResult.ACCEPTED

    def _set_mode(self, c: m.CommandLong) -> MavResult:
        if not int(c.param1) & 1:
            return MavResult.DENIED
        return _as_result(self.modes.enter_number(int(c.param2)))

    def _condition_yaw(self, c: m.CommandLong) -> MavResult:
        if not self.board.profile.hovers:
            return MavResult.UNSUPPORTED
        if not 0.0 <= c.param1 <= 360.0 or c.param4 not in (0.0, 1.0):
            return MavResult.FAILED
        # Accepted in any mode and on the ground; it moves only where auto-yaw is in charge.
        if self.status.armed and self.status.mode == "GUIDED" and not self.board.body.landed:
            slew = math.radians(c.param2) if c.param2 > 0.0 else _DEFAULT_SLEW_RADPS
            direction = int(math.copysign(1.0, c.param3)) if c.param3 else 0
            self.hover.turn(math.radians(c.param1), slew, direction, relative=c.param4 == 1.0)
        return MavResult.ACCEPTED

    def _takeoff(self, c: m.CommandLong) -> MavResult:
        if self.board.profile.chassis != "copter":
            return MavResult.UNSUPPORTED
        if not self.status.armed or self.status.mode != "GUIDED" or c.param7 < _TAKEOFF_MIN_M:
            return MavResult.FAILED
        self.hover.hold()
        self.hover.height_m = c.param7
        return MavResult.ACCEPTED

    def _land(self, c: m.CommandLong) -> MavResult:
        if self.board.profile.chassis != "copter":
            return MavResult.UNSUPPORTED
        return _as_result(self.modes.enter("LAND"))

    def _reboot(self, c: m.CommandLong) -> MavResult:
        if c.param1 not in (1.0, 3.0):
            return MavResult.UNSUPPORTED
        if self.status.armed:
            return MavResult.FAILED
        self.status.reboot_wanted = True
        return MavResult.ACCEPTED

    def _run_checks(self, c: m.CommandLong) -> MavResult:
        if self.status.armed:
            return MavResult.TEMPORARILY_REJECTED
        self.arming.tell_refusals("PreArm")
        return MavResult.ACCEPTED

    def _preflight_calibration(self, c: m.CommandLong) -> MavResult:
        if self.status.armed:
            return MavResult.DENIED
        if c.param2 != _FORCE_SAVE_CALIBRATION:
            return MavResult.UNSUPPORTED
        for instance in INSTANCES:
            self._save_device_id(instance)
        return MavResult.ACCEPTED

    def _set_sensor_offsets(self, c: m.CommandLong) -> MavResult:
        if self.status.armed:
            return MavResult.FAILED
        instance = _SENSOR_OF_COMPASS.get(int(c.param1))
        if instance is None:
            return MavResult.UNSUPPORTED
        self._write_vector("OFS", instance, (c.param2, c.param3, c.param4))
        self._save_device_id(instance)
        return MavResult.ACCEPTED

    def _fixed_yaw_calibration(self, c: m.CommandLong) -> MavResult:
        """Set offsets from one reading and a known true yaw; diagonals become 1 (and the scale is forgotten).

        Compasses that COMPASS_USE turns off are passed over, with the same answer.
        """
        bank = self.compasses
        if not self.board.ready:
            return MavResult.FAILED
        mask = int(c.param2)
        expected = bank.expected_field(math.radians(c.param1))
        for bit, instance in enumerate(INSTANCES):
            if bank.in_use(instance) and (not mask or mask & (1 << bit)):
                raw = bank.uncorrected(instance)
                x, y, z = (want - have for want, have in zip(expected, raw, strict=True))
                self._write_vector("OFS", instance, (x, y, z))
                self._write_vector("DIA", instance, (1.0, 1.0, 1.0))
                self._write_vector("ODI", instance, (0.0, 0.0, 0.0))
                self._save_device_id(instance)
        return MavResult.ACCEPTED

    def _use_sources(self, c: m.CommandLong) -> MavResult:
        return MavResult.ACCEPTED if self.sources.use(int(c.param1)) else MavResult.DENIED

    def _start_magnetometer_calibration(self, c: m.CommandLong) -> MavResult:
        if self.status.armed:
            return MavResult.FAILED
        mask, in_use = int(c.param1), self.compasses.in_use
        chosen = tuple(i for i in INSTANCES if (mask & 1 << i - 1 if mask else in_use(i)))
        if not chosen or not all(in_use(i) for i in chosen):
            return MavResult.FAILED
        self.calibration.start(chosen, math.hypot(*self.board.world.field_ned_mgauss))
        return MavResult.ACCEPTED

    def _accept_magnetometer_calibration(self, c: m.CommandLong) -> MavResult:
        found = self.calibration.accept()
        for instance, cure in (found or {}).items():
            self._write_vector("OFS", instance, cure.offsets_mgauss)
            self._write_vector("DIA", instance, cure.diagonals)
            self._write_vector("ODI", instance, cure.off_diagonals)
            self.parameters.store.set(ardupilot_name("SCALE", instance), cure.scale)
            self._save_device_id(instance)
        self.compasses.parameters_changed()
        return _as_result(found is not None)

    def _cancel_magnetometer_calibration(self, c: m.CommandLong) -> MavResult:
        self.calibration.cancel()
        return MavResult.ACCEPTED

    def _write_vector(self, stem: str, instance: int, values: Vector) -> None:
        """Store a compass vector and send it to every station, as a save by the firmware itself does."""
        for axis, value in zip("XYZ", values, strict=True):
            name = ardupilot_name(f"{stem}_{axis}", instance)
            if self.parameters.store.set(name, value):
                self.parameters.announce(name)
        self.compasses.parameters_changed()

    def _save_device_id(self, instance: int) -> None:
        """Store the id of the compass's hardware, which makes it count as calibrated."""
        name = ardupilot_name("DEV_ID", instance)
        self.parameters.store.set(name, self.compasses.hardware_ids[instance - 1])


def _as_result(done: bool) -> MavResult:
    return MavResult.ACCEPTED if done else MavResult.FAILED
