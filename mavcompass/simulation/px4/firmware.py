"""PX4 put together: a multicopter of version 1.15, which turns in OFFBOARD only.

OFFBOARD wants a stream of setpoints before the switch and as long as it lasts; there is no command to
turn. Calibrations are CAL_MAGn parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from mavcompass import messages as m
from mavcompass.compass_parameters import px4_name, px4_sensor_to_body, px4_values
from mavcompass.enums import MavSeverity, MavType
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.firmware import Firmware, Sender
from mavcompass.simulation.autopilot.guidance import HoverGuidance, Radio
from mavcompass.simulation.autopilot.parameters import (
    PX4_MANNERS,
    ParameterServer,
    ParameterStore,
    parameter_table,
)
from mavcompass.simulation.autopilot.telemetry import Telemetry
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.px4.commands import Commands
from mavcompass.simulation.px4.compasses import INSTANCES, Px4Compasses
from mavcompass.simulation.px4.flight import BY_HAND, Arming, Flight, Modes, Setpoints, mode_of_custom
from mavcompass.simulation.px4.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.px4.reports import Px4Reports

# Texts go where a ground station was heard within this time.
_STATION_HEARD_S = 2.5
# How the first compass is turned in its mast, MAV_SENSOR_ORIENTATION.
_MOUNTINGS = (0, 2, 4, 6)


class Px4(Firmware):
    """Be the software of one simulated PX4 multicopter."""

    modes: Modes
    compasses: Px4Compasses

    def __init__(
        self, board: Board, parameters: Mapping[str, float], storage: MutableMapping[str, float] | None
    ) -> None:
        self.board = board
        board.read_for(-1.0)
        self.store = store = ParameterStore(
            parameter_table("px4.param"), _defaults(board, parameters), storage
        )
        self.parameters = served = ParameterServer(board, store, PX4_MANNERS)
        self.status = status = Status("POSCTL")
        self.compasses = compasses = Px4Compasses(board, store, status)
        self.radio = radio = Radio(throttle_low=False, hovers=True)
        hover, setpoints = HoverGuidance(board), Setpoints(board)
        self.modes = modes = Modes(board, status, hover, setpoints)
        self.arming = arming = Arming(board, status, store, compasses)
        self.reports = reports = Px4Reports(board, status, compasses, radio, arming, store)
        self.telemetry = telemetry = Telemetry(board, reports)
        self.flight = flight = Flight(board, status, store, radio, hover, setpoints, modes, arming)
        self.steering = flight
        self.calibration = MagnetometerCalibration(board)
        self.commands = Commands(
            board, status, modes, arming, flight, compasses, self.calibration, served, telemetry
        )

    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins hovering in HOLD instead."""
        self.parameters.reset()
        self.status.reboot_wanted = self.status.armed = False
        self.calibration.state = "off"
        self.align()
        self.status.armed = armed
        self.status.mode = "HOLD" if armed else "POSCTL"
        self.flight.boot(armed)

    def hear(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that only this firmware knows what to do with."""
        match message:
            case m.Heartbeat(type=MavType.GCS):
                self.board.read_for(_STATION_HEARD_S)
            case m.SetMode():
                self.modes.enter(mode_of_custom(message.custom_mode))
            case m.SetPositionTargetLocalNed():
                self.flight.take_setpoint(message)
            case m.RcChannelsOverride() | m.ManualControl():
                self.radio.override(message, self.board.boot_time_s)

    def use_compasses(self, dt_s: float) -> None:
        """Correct the new readings for the filter, which learns the gyro's bias where the vehicle stands."""
        super().use_compasses(dt_s)
        if self.board.body.landed and not self.status.armed:
            self.board.filter.rest(dt_s, self.board.sensors.samples[0].gyro_radps[2])
        found = self.calibration.observe(dt_s, self.compasses.raw_sensor_mgauss)
        for instance, cure in zip(INSTANCES, found or (), strict=False):
            self.compasses.store_found(instance, cure)

    def attend(self) -> None:
        """Time-outs and lists."""
        self.flight.watch_setpoints()
        self.parameters.attend()

    def pilot_moves_stick(self, channel: int, pwm: int, for_s: float) -> None:
        """Hold a stick; in flight that takes the vehicle over from OFFBOARD and HOLD."""
        super().pilot_moves_stick(channel, pwm, for_s)
        if self.status.armed and self.status.mode not in BY_HAND:
            self.modes.enter("POSCTL")
            self.board.say("Pilot took over using sticks")

    def battery_failsafe(self) -> None:
        """Warn, and land."""
        self.status.battery_low = self.status.failsafe = True
        self.board.say("Critical battery, land now", MavSeverity.CRITICAL)
        if self.status.armed:
            self.modes.enter("LAND")
            self.board.say("Failsafe activated: Autopilot switching to Land", MavSeverity.CRITICAL)


def _defaults(board: Board, parameters: Mapping[str, float]) -> dict[str, float]:
    mounting = float(generator(board.seed, "mounting").choice(_MOUNTINGS))
    values = {"MAV_SYS_ID": float(board.system), px4_name("ROT", INSTANCES[0]): mounting, **parameters}
    for instance in INSTANCES:
        in_force, mounted = board.compass_setups[instance - 1].in_force, px4_sensor_to_body(values, instance)
        values = px4_values(in_force, instance, mounted) | values
    return values
