"""ArduPilot put together: Rover, Copter, Sub and Plane with rotors as firmware 4.6.3 was seen to behave."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from mavcompass import messages as m
from mavcompass.compass_parameters import ardupilot_values
from mavcompass.enums import MavResult, MavSeverity
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.commands import Commands, Sources
from mavcompass.simulation.ardupilot.compasses import INSTANCES, CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.ardupilot.modes import Modes, mode_rules
from mavcompass.simulation.ardupilot.reports import ArduPilotReports
from mavcompass.simulation.ardupilot.steering import Steering
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.firmware import Firmware, Sender
from mavcompass.simulation.autopilot.guidance import GroundGuidance, HoverGuidance, Radio
from mavcompass.simulation.autopilot.parameters import (
    ARDUPILOT_MANNERS,
    ParameterServer,
    ParameterStore,
    parameter_table,
)
from mavcompass.simulation.autopilot.telemetry import Telemetry

_PARAMETER_FILES = {
    "skid": ("ardupilot.param", "rover.param"),
    "ackermann": ("ardupilot.param", "rover.param", "ackermann-rover.param"),
    "boat": ("ardupilot.param", "rover.param", "boat.param"),
    "copter": ("ardupilot.param", "copter.param"),
    "sub": ("ardupilot.param", "sub.param"),
}
_BATTERY_FAILSAFE_MODES = {"rover": "HOLD", "copter": "LAND", "sub": "SURFACE", "plane": "LAND"}
_SET_MODE_ID = 11
# Why it will not arm, and how long it has run.
_TOLD_EVERY_S = 30.0
_IN_FLIGHT_ALIGNMENT_M = 2.5


class ArduPilot(Firmware):
    """Be the software of one simulated ArduPilot vehicle."""

    arming: Arming
    modes: Modes
    steering: Steering
    compasses: CompassBank

    def __init__(
        self, board: Board, parameters: Mapping[str, float], storage: MutableMapping[str, float] | None
    ) -> None:
        table = parameter_table(*_PARAMETER_FILES[board.profile.chassis])
        self.board = board
        self.store = store = ParameterStore(table, _defaults(board) | dict(parameters), storage)
        self.parameters = served = ParameterServer(board, store, ARDUPILOT_MANNERS)
        self.compasses = compasses = CompassBank(board, store)
        self.calibration = calibration = MagnetometerCalibration()
        self.sources = sources = Sources(board, store)
        self.radio = radio = Radio(board.profile.firmware == "copter", board.profile.hovers)
        self.ground, self.hover = ground, hover = GroundGuidance(board), HoverGuidance(board)
        rules = mode_rules(board.profile)
        self.status = status = Status(rules.name(board.profile.initial_mode) or "")
        self.modes = modes = Modes(board, status, rules, ground, hover)
        self.arming = arming = Arming(board, status, store, rules, compasses, calibration, hover)
        self.reports = reports = ArduPilotReports(board, status, compasses, radio, rules, arming, store)
        compasses.battery_volts = reports.battery_volts
        self.telemetry = telemetry = Telemetry(board, reports)
        self.steering = Steering(board, status, store, rules, radio, ground, hover, arming)
        self.commands = Commands(
            board, status, modes, arming, hover, compasses, calibration, sources, served, telemetry
        )

    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins in GUIDED with the motors running instead."""
        profile, world = self.board.profile, self.board.world
        self.parameters.reset()
        self.calibration.reset()
        self.sources.boot()
        self.ground.stop()
        self.hover.release()
        self.status.reboot_wanted = self.status.failsafe = False
        if self.store["COMPASS_AUTODEC"]:
            self.store.set("COMPASS_DEC", world.declination_rad, keep=False)
        self.align()
        self.status.armed = armed
        number = profile.guided_mode if armed else int(self.store["INITIAL_MODE"])
        self.status.mode = self.modes.rules.name(number) or self.status.mode
        if armed:
            self.hover.hold_here()
        now = self.board.boot_time_s
        self._next_prearm_s = self._next_statistics_s = now + _TOLD_EVERY_S
        self._next_second_s = now + 1.0
        # In the middle of a mission everything has been said and aligned.
        self._told_ready = self._aligned_in_flight = armed
        if not armed:
            self.board.say("ArduPilot Ready")
            steering = self.compasses.steering
            if steering is not None:
                self.board.say(f"EKF3 IMU0 MAG{steering - 1} initial yaw alignment complete")

    def hear(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that only this firmware knows what to do with."""
        guided = self.status.mode == "GUIDED"
        match message:
            case m.SetMode():
                done = bool(message.base_mode & 1) and self.modes.enter_number(message.custom_mode)
                self.acknowledge(_SET_MODE_ID, MavResult.ACCEPTED if done else MavResult.FAILED, sender)
            case m.RequestDataStream():
                self.telemetry.set_group(message, sender.port)
            case m.SetPositionTargetLocalNed() if guided:
                self.steering.take_position_target(message)
            case m.SetAttitudeTarget() if guided:
                self.steering.take_attitude_target(message)
            case m.RcChannelsOverride() | m.ManualControl():
                if sender.system == int(self.store["SYSID_MYGCS"]):
                    self.radio.override(message, self.board.boot_time_s)

    def attend(self) -> None:
        """Do what is due: time-outs, lists, texts, parameters that nobody asked for, yaw alignment."""
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
            self._next_statistics_s += _TOLD_EVERY_S
            self.store.set("STAT_RUNTIME", self.store["STAT_RUNTIME"] + _TOLD_EVERY_S, keep=False)
            # Nobody asked for these; a client that takes any PARAM_VALUE for its answer errs.
            self.parameters.announce("STAT_RUNTIME")
            if not self.status.armed:
                self.parameters.announce("BARO1_GND_PRESS")
        if not self.status.armed:
            self._on_the_ground(now)
        elif not self._aligned_in_flight and self.board.body.height_m > _IN_FLIGHT_ALIGNMENT_M:
            self._align_in_flight()
        self.parameters.attend()

    def _on_the_ground(self, now: float) -> None:
        if now >= self._next_prearm_s:
            self._next_prearm_s = now + _TOLD_EVERY_S
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

    def use_compasses(self, dt_s: float) -> None:
        """Correct the new readings for the filter, where its sources name it; its calibration listens."""
        self.compasses.read()
        self.sources.correct(dt_s, self.compasses.yaw())
        if self.calibration.running:
            self.calibration.observe({i: self.compasses.raw(i) for i in INSTANCES})

    def emergency_yaw_reset(self) -> None:
        """Set the compasses aside, as EKF3 does in flight where the receiver's velocity contradicts them."""
        self.sources.compasses_aside = True
        self.board.say("EKF3 IMU0 emergency yaw reset", MavSeverity.WARNING)

    def battery_failsafe(self) -> None:
        """Warn, and stop or come down."""
        self.status.battery_low = self.status.failsafe = True
        volts, used = self.reports.battery_volts(), self.board.consumed_mah
        self.board.say(f"Battery 1 is low {volts:.2f}V used {used:.0f} mAh", MavSeverity.WARNING)
        self.board.say("Battery Failsafe", MavSeverity.CRITICAL)
        self.modes.enter(_BATTERY_FAILSAFE_MODES[self.board.profile.firmware])


def _defaults(board: Board) -> dict[str, float]:
    values: dict[str, float] = {
        "COMPASS_DEC": board.world.declination_rad,
        "SYSID_THISMAV": float(board.system),
    }
    for instance, setup in zip(INSTANCES, board.compass_setups, strict=True):
        values |= ardupilot_values(setup.in_force, instance)
    return values
