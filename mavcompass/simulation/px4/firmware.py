"""PX4's behaviour: a multicopter of version 1.15, which turns in OFFBOARD only.

OFFBOARD wants a stream of setpoints before the switch and as long as it lasts; there is no command to
turn. Calibrations are CAL_MAGn parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, MutableMapping
from typing import TYPE_CHECKING

from mavcompass import messages as m
from mavcompass.compass_parameters import px4_name, px4_values
from mavcompass.correction import FieldCorrection, Vector
from mavcompass.enums import MavAutopilot, MavResult, MavSeverity, MavState
from mavcompass.frames import sensor_orientation_matrix
from mavcompass.simulation.autopilot.attitude_filter import compass_yaw
from mavcompass.simulation.autopilot.firmware import Sender
from mavcompass.simulation.autopilot.parameter_server import PX4_MANNERS, ParameterServer
from mavcompass.simulation.autopilot.parameter_store import ParameterStore, parameter_table
from mavcompass.simulation.autopilot.radio import Radio
from mavcompass.simulation.autopilot.stream_commands import as_long
from mavcompass.simulation.autopilot.streams import MESSAGE_IDS
from mavcompass.simulation.physics.motion import Drive
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.px4 import modes
from mavcompass.simulation.px4.commands import answer_command
from mavcompass.simulation.px4.compasses import INSTANCES, Px4Compasses
from mavcompass.simulation.px4.flight import Flight
from mavcompass.simulation.px4.reports import Px4Reports

if TYPE_CHECKING:
    from mavcompass.simulation.vehicle import SimulatedAutopilot

# How the first compass is turned in its mast, MAV_SENSOR_ORIENTATION.
_MOUNTINGS = (0, 2, 4, 6)
# What a ground station's link carries unasked, hertz.
_DEFAULT_RATES: dict[type[m.Message], float] = {
    m.SysStatus: 1.0,
    m.SystemTime: 1.0,
    m.Attitude: 15.0,
    m.GlobalPositionInt: 5.0,
    m.LocalPositionNed: 1.0,
    m.GpsRawInt: 1.0,
    m.VfrHud: 4.0,
    m.ExtendedSysState: 1.0,
    m.HighresImu: 1.5,
    m.RcChannels: 5.0,
}


class Px4:
    """Be the software of one simulated PX4 multicopter."""

    def __init__(
        self,
        vehicle: SimulatedAutopilot,
        parameters: Mapping[str, float],
        storage: MutableMapping[str, float] | None,
    ) -> None:
        self.vehicle = vehicle
        self.mounting = int(generator(vehicle.seed, "mounting").choice(_MOUNTINGS))
        defaults = {"MAV_SYS_ID": float(vehicle.system)} | self._calibrations() | dict(parameters)
        self.store = ParameterStore(parameter_table("px4.param"), defaults, storage)
        self.parameters = ParameterServer(vehicle, self.store, PX4_MANNERS)
        self.compasses = Px4Compasses(vehicle, self.store, self.mounting)
        self.radio = Radio(throttle_low=False)
        self.flight = Flight(self)
        self.reports = Px4Reports(self)
        self.available = frozenset(MESSAGE_IDS[kind] for kind in self.reports.kinds)
        self.armed = False
        self.mode = "POSCTL"
        self.battery_low = False
        self.reboot_wanted = False

    def _calibrations(self) -> dict[str, float]:
        values: dict[str, float] = {px4_name("ROT", INSTANCES[0]): float(self.mounting)}
        for instance in INSTANCES:
            mounting = self.mounting if instance == INSTANCES[0] else 0
            in_force = self.vehicle.compass_setups[instance - 1].in_force
            values |= px4_values(in_force, instance, sensor_orientation_matrix(mounting))
        return values

    # --- power-up, arming, modes -------------------------------------------------------------------

    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins hovering in HOLD instead."""
        self.parameters.reset()
        self.reboot_wanted = False
        self.compasses.boot()
        self.compasses.read()
        body = self.vehicle.body
        self.vehicle.filter.align(body.roll_rad, body.pitch_rad, self._compass_yaw())
        self.armed = armed
        self.mode = "HOLD" if armed else "POSCTL"
        self.flight.boot(armed)

    def refusal(self) -> str | None:
        """Say why it will not arm, None where it will."""
        if not self.vehicle.ready:
            return "Preflight Fail: ekf2 missing data"
        if self.compasses.steering is None or not self.compasses.healthy(self.compasses.steering):
            return "Preflight Fail: No valid data from Compass 0"
        first, second = (
            math.atan2(-field[1], field[0]) for field in (self.compasses.fields[0], self.compasses.fields[1])
        )
        apart = abs(math.degrees(math.remainder(first - second, 2.0 * math.pi)))
        limit = self.store["COM_ARM_MAG_ANG"]
        if 0.0 < limit < apart:
            return "Preflight Fail: Compasses inconsistent"
        return None

    def arm(self, forced: bool) -> bool:
        """Arm if nothing speaks against it, or forced."""
        reason = None if forced else self.refusal()
        if reason:
            self.vehicle.say(reason, MavSeverity.CRITICAL)
            self.vehicle.say("Arming denied: Resolve system health failures first", MavSeverity.CRITICAL)
            return False
        self.armed = True
        self.vehicle.say("Armed by external command")
        return True

    def disarm(self) -> None:
        """Stop the motors."""
        if self.armed:
            self.armed = False
            self.vehicle.say("Disarmed by external command")

    def set_mode(self, name: str | None) -> bool:
        """Change mode; False where it is refused."""
        if name is None or not modes.exists(name) or name in modes.IMPOSSIBLE:
            return False
        if name in modes.NEED_POSITION and not self.vehicle.ready:
            return False
        if name == "OFFBOARD" and not self.flight.setpoints_flow:
            self.vehicle.say("Switching to Offboard is currently not available", MavSeverity.CRITICAL)
            return False
        if name != self.mode:
            self.mode = name
            self.flight.mode_changed()
        return True

    # --- messages ----------------------------------------------------------------------------------

    def handle(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that is for this vehicle."""
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        if system not in (0, self.vehicle.system) or component not in (0, self.vehicle.component):
            return
        match message:
            case m.ParamRequestRead():
                self.parameters.read(message, sender)
            case m.ParamSet():
                if self.parameters.set(message):
                    self.compasses.parameters_changed()
            case m.ParamRequestList():
                self.parameters.start_list(message, sender)
            case m.CommandLong():
                self._acknowledge(message.command, answer_command(self, message, sender), sender)
            case m.CommandInt():
                self._acknowledge(message.command, answer_command(self, as_long(message), sender), sender)
            case m.SetMode():
                self.set_mode(modes.mode_of_custom(message.custom_mode))
            case m.SetPositionTargetLocalNed():
                self.flight.take_setpoint(message)
            case m.RcChannelsOverride() | m.ManualControl():
                self.radio.override(message, self.vehicle.boot_time_s)

    def _acknowledge(self, command: int, result: MavResult, sender: Sender) -> None:
        ack = m.CommandAck(command, result, 0, 0, sender.system, sender.component)
        self.vehicle.send(ack, sender.port)
        if self.reboot_wanted:
            self.reboot_wanted = False
            self.vehicle.reboot()

    # --- at every tick -----------------------------------------------------------------------------

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        return self.flight.control(dt_s)

    def attend(self) -> None:
        """Time-outs and lists."""
        self.flight.watch_setpoints()
        self.parameters.attend()

    def use_compasses(self, dt_s: float) -> None:
        """Correct the new readings and let the filter have the one that steers."""
        self.compasses.read()
        self.vehicle.filter.correct(dt_s, self._compass_yaw())

    def _compass_yaw(self) -> float | None:
        steering = self.compasses.steering
        if steering is None or not self.compasses.healthy(steering):
            return None
        estimate, field = self.vehicle.filter, self.compasses.fields[steering - 1]
        declination = self.vehicle.world.declination_rad
        return compass_yaw(field, estimate.roll_rad, estimate.pitch_rad, declination)

    # --- reports -----------------------------------------------------------------------------------

    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force of compass 1 or 2, in body axes."""
        return self.compasses.correction(instance)

    def heartbeat(self) -> m.Heartbeat:
        """Describe the vehicle."""
        state = MavState.ACTIVE if self.armed else MavState.STANDBY
        return m.Heartbeat(
            type=self.vehicle.profile.mav_type,
            autopilot=MavAutopilot.PX4,
            base_mode=modes.base_mode(self.mode, self.armed),
            custom_mode=modes.custom_mode(self.mode),
            system_status=MavState.CRITICAL if self.battery_low else state,
        )

    def report(self, kind: type[m.Message], time_us: int, share: float) -> m.Message | None:
        """Build a telemetry message."""
        return self.reports.build(kind, time_us, share)

    def default_intervals(self) -> Mapping[int, int]:
        """Return what a ground station's link carries unasked."""
        return {MESSAGE_IDS[kind]: int(1e6 / rate) for kind, rate in _DEFAULT_RATES.items()}

    # --- what happens to it ------------------------------------------------------------------------

    def pilot_disarms(self) -> None:
        """Disarm by the pilot's hand."""
        self.disarm()

    def pilot_switches_mode(self, mode: str) -> None:
        """Change mode by the pilot's hand."""
        self.set_mode(mode)

    def pilot_moves_stick(self, channel: int, pwm: int, for_s: float) -> None:
        """Hold a stick; in flight that takes the vehicle over from OFFBOARD and HOLD."""
        self.radio.hold(channel, pwm, self.vehicle.boot_time_s + for_s)
        if self.armed and self.mode not in modes.BY_HAND:
            self.set_mode("POSCTL")
            self.vehicle.say("Pilot took over using sticks")

    def battery_failsafe(self) -> None:
        """Warn, and land."""
        self.battery_low = True
        self.vehicle.say("Critical battery, land now", MavSeverity.CRITICAL)
        if self.armed:
            self.set_mode("LAND")
            self.vehicle.say("Failsafe activated: Autopilot switching to Land", MavSeverity.CRITICAL)

    def lose_compass(self, instance: int, healthy: bool, value: Vector | None) -> None:
        """Stop a compass, at a raw value or at its last reading."""
        self.compasses.lose(instance, healthy, value)
