"""ArduPilot put together: Rover, Copter and Sub as firmware 4.6.3 was seen to behave."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from mavcompass import messages as m
from mavcompass.compass_parameters import ardupilot_values
from mavcompass.enums import MavResult, MavSeverity
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.commands import Commands
from mavcompass.simulation.ardupilot.compasses import INSTANCES, CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.ardupilot.modes import Modes, mode_rules
from mavcompass.simulation.ardupilot.reports import ArduPilotReports
from mavcompass.simulation.ardupilot.routine import Routine
from mavcompass.simulation.ardupilot.sources import Sources
from mavcompass.simulation.ardupilot.steering import Steering
from mavcompass.simulation.ardupilot.targets import attitude_target, position_target
from mavcompass.simulation.autopilot import (
    ARDUPILOT_MANNERS,
    Board,
    Firmware,
    GroundGuidance,
    HoverGuidance,
    ParameterServer,
    ParameterStore,
    Radio,
    Sender,
    Status,
    Telemetry,
    parameter_table,
)

_PARAMETER_FILES = {
    "skid": ("ardupilot.param", "rover.param"),
    "ackermann": ("ardupilot.param", "rover.param", "ackermann-rover.param"),
    "boat": ("ardupilot.param", "rover.param", "boat.param"),
    "copter": ("ardupilot.param", "copter.param"),
    "sub": ("ardupilot.param", "sub.param"),
}
_BATTERY_FAILSAFE_MODES = {"rover": "HOLD", "copter": "LAND", "sub": "SURFACE"}
_SET_MODE_ID = 11


class ArduPilot(Firmware):
    """Be the software of one simulated ArduPilot vehicle."""

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
        self.radio = radio = Radio(throttle_low=board.profile.chassis == "copter")
        self.ground, self.hover = ground, hover = GroundGuidance(board), HoverGuidance(board)
        rules = mode_rules(board.profile)
        self.status = status = Status(rules.name(board.profile.initial_mode) or "")
        self.modes = modes = Modes(board, status, rules, ground, hover)
        self.arming = arming = Arming(board, status, store, rules, compasses, calibration, hover)
        self.reports = reports = ArduPilotReports(board, status, compasses, radio, rules, arming, store)
        self.telemetry = telemetry = Telemetry(board, reports)
        self.steering = Steering(board, status, store, rules, radio, ground, hover, arming)
        self.routine = Routine(board, status, served, compasses, calibration, ground, hover, arming)
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
        self.routine.boot(in_the_middle=armed)

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
                self.steering.take_position_target(position_target(self.board, message), message.type_mask)
            case m.SetAttitudeTarget() if guided and not self.board.profile.hovers:
                if target := attitude_target(self.board, message):
                    self.ground.set_target(target)
            case m.RcChannelsOverride() | m.ManualControl():
                if sender.system == int(self.store["SYSID_MYGCS"]):
                    self.radio.override(message, self.board.boot_time_s)

    def attend(self) -> None:
        """Do what is due: time-outs, lists, texts."""
        self.routine.attend()
        self.parameters.attend()

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
