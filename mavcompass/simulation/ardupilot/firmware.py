"""ArduPilot's behaviour: Rover, Copter and Sub as firmware 4.6.3 was seen to behave."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import TYPE_CHECKING

from mavcompass import messages as m
from mavcompass.compass_parameters import ardupilot_values
from mavcompass.correction import FieldCorrection, Vector
from mavcompass.enums import MavAutopilot, MavResult, MavSeverity, MavState
from mavcompass.simulation.ardupilot.arming import arming_refusals
from mavcompass.simulation.ardupilot.commands import answer_command
from mavcompass.simulation.ardupilot.compasses import INSTANCES, CompassBank
from mavcompass.simulation.ardupilot.magnetometer_calibration import MagnetometerCalibration
from mavcompass.simulation.ardupilot.modes import mode_rules
from mavcompass.simulation.ardupilot.reports import ArduPilotReports
from mavcompass.simulation.ardupilot.routine import Routine
from mavcompass.simulation.ardupilot.steering import Steering
from mavcompass.simulation.autopilot.attitude_filter import compass_yaw
from mavcompass.simulation.autopilot.firmware import Sender
from mavcompass.simulation.autopilot.guidance import GroundGuidance, HoverGuidance
from mavcompass.simulation.autopilot.parameter_server import ARDUPILOT_MANNERS, ParameterServer
from mavcompass.simulation.autopilot.parameter_store import ParameterStore, parameter_table
from mavcompass.simulation.autopilot.radio import Radio
from mavcompass.simulation.autopilot.stream_commands import as_long
from mavcompass.simulation.autopilot.streams import MESSAGES
from mavcompass.simulation.autopilot.targets import attitude_target, position_target
from mavcompass.simulation.physics.motion import Drive

if TYPE_CHECKING:
    from mavcompass.simulation.vehicle import SimulatedAutopilot

_PARAMETER_FILES = {
    "skid": ("ardupilot.param", "rover.param"),
    "ackermann": ("ardupilot.param", "rover.param", "ackermann-rover.param"),
    "boat": ("ardupilot.param", "rover.param", "boat.param"),
    "copter": ("ardupilot.param", "copter.param"),
    "sub": ("ardupilot.param", "sub.param"),
}
_SET_MODE_ID = 11


class ArduPilot:
    """Be the software of one simulated ArduPilot vehicle."""

    available = frozenset(MESSAGES)

    def __init__(
        self,
        vehicle: SimulatedAutopilot,
        parameters: Mapping[str, float],
        storage: MutableMapping[str, float] | None,
    ) -> None:
        self.vehicle = vehicle
        self.modes = mode_rules(vehicle.profile)
        table = parameter_table(*_PARAMETER_FILES[vehicle.profile.chassis])
        self.store = ParameterStore(table, self._defaults(parameters), storage)
        self.parameters = ParameterServer(vehicle, self.store, ARDUPILOT_MANNERS)
        self.compasses = CompassBank(vehicle, self.store)
        self.magnetometer_calibration = MagnetometerCalibration()
        self.radio = Radio(throttle_low=vehicle.profile.chassis == "copter")
        self.ground = GroundGuidance(vehicle)
        self.hover = HoverGuidance(vehicle)
        self.steering = Steering(self)
        self.reports = ArduPilotReports(self)
        self.armed = False
        self.mode = self.modes.name(vehicle.profile.initial_mode) or ""
        self.failsafe = False
        self.battery_low = False
        self.reboot_wanted = False
        self.routine = Routine(self)

    def _defaults(self, parameters: Mapping[str, float]) -> dict[str, float]:
        values: dict[str, float] = {
            "COMPASS_DEC": self.vehicle.world.declination_rad,
            "SYSID_THISMAV": float(self.vehicle.system),
        }
        for instance, setup in zip(INSTANCES, self.vehicle.compass_setups, strict=True):
            values |= ardupilot_values(setup.in_force, instance)
        return values | dict(parameters)

    # --- power-up, arming, modes -------------------------------------------------------------------

    def boot(self, armed: bool) -> None:
        """Power up; `armed` begins in GUIDED with the motors running instead."""
        self.parameters.reset()
        self.magnetometer_calibration = MagnetometerCalibration()
        self.ground.stop()
        self.hover.release()
        self.reboot_wanted = self.failsafe = False
        if self.store["COMPASS_AUTODEC"]:
            self.store.set("COMPASS_DEC", self.vehicle.world.declination_rad, keep=False)
        self.compasses.boot()
        self.compasses.read()
        body = self.vehicle.body
        self.vehicle.filter.align(body.roll_rad, body.pitch_rad, self.compass_yaw())
        self.armed = armed
        number = self.vehicle.profile.guided_mode if armed else int(self.store["INITIAL_MODE"])
        self.mode = self.modes.name(number) or self.mode
        if armed:
            self.hover.height_m = body.height_m
            self.hover.hold()
        self.routine.boot(in_the_middle=armed)

    def arm(self, forced: bool) -> bool:
        """Arm if nothing speaks against it, or forced."""
        if not forced and self.tell_refusals("Arm"):
            return False
        self.armed = True
        hovers = self.vehicle.profile.hovers
        self.vehicle.say("Arming motors" if hovers else "Throttle armed")
        if self.vehicle.profile.chassis == "sub":
            self.hover.height_m = self.vehicle.body.height_m
            self.hover.hold()
        return True

    def disarm(self) -> None:
        """Stop the motors."""
        if self.armed:
            self.armed = False
            self.hover.release()
            self.vehicle.say("Disarming motors" if self.vehicle.profile.hovers else "Throttle disarmed")

    def tell_refusals(self, prefix: str) -> bool:
        """Send why it will not arm; True where there is a reason."""
        reasons = arming_refusals(self)
        for reason in reasons if prefix == "PreArm" else reasons[:1]:
            self.vehicle.say(f"{prefix}: {reason}", MavSeverity.CRITICAL)
        return bool(reasons)

    def set_mode_number(self, number: int) -> bool:
        """Change to the mode of a number; False where it is refused."""
        name = self.modes.name(number)
        return name is not None and self.set_mode(name)

    def set_mode(self, name: str) -> bool:
        """Change mode; False where it is refused."""
        if name in self.modes.impossible or name not in self.modes.names:
            return False
        if name in self.modes.need_position and not self.vehicle.ready:
            self.vehicle.say(f"Mode change to {name} failed: requires position", MavSeverity.WARNING)
            return False
        if name != self.mode:
            self.mode = name
            self.ground.stop()
            if self.armed and not self.vehicle.body.landed:
                self.hover.height_m = self.vehicle.body.height_m
                self.hover.hold()
        return True

    # --- messages ----------------------------------------------------------------------------------

    def handle(self, message: m.Message, sender: Sender) -> None:
        """Act on a message that is for this vehicle."""
        if not self._is_for_me(message):
            return
        match message:
            case m.ParamRequestRead():
                self.parameters.read(message, sender)
            case m.ParamSet():
                if self.parameters.set(message) and message.param_id.startswith("COMPASS"):
                    self.compasses.parameters_changed()
            case m.ParamRequestList():
                self.parameters.start_list(message, sender)
            case m.CommandLong():
                self._acknowledge(message.command, answer_command(self, message, sender), sender)
            case m.CommandInt():
                self._acknowledge(message.command, answer_command(self, as_long(message), sender), sender)
            case m.SetMode():
                done = bool(message.base_mode & 1) and self.set_mode_number(message.custom_mode)
                result = MavResult.ACCEPTED if done else MavResult.FAILED
                self._acknowledge(_SET_MODE_ID, result, sender)
            case m.RequestDataStream():
                rate = message.req_message_rate if message.start_stop else 0
                streams = self.vehicle.streams(sender.port)
                streams.set_group(message.req_stream_id, rate, self.vehicle.now_us)
            case m.SetPositionTargetLocalNed():
                if self.mode == "GUIDED":
                    self.steering.take_position_target(position_target(self, message), message.type_mask)
            case m.SetAttitudeTarget():
                target = attitude_target(self, message)
                if self.mode == "GUIDED" and target and not self.vehicle.profile.hovers:
                    self.ground.set_target(target)
            case m.RcChannelsOverride() | m.ManualControl():
                if sender.system == int(self.store["SYSID_MYGCS"]):
                    self.radio.override(message, self.vehicle.boot_time_s)

    def _is_for_me(self, message: m.Message) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        return system in (0, self.vehicle.system) and component in (0, self.vehicle.component)

    def _acknowledge(self, command: int, result: MavResult, sender: Sender) -> None:
        ack = m.CommandAck(command, result, 0, 0, sender.system, sender.component)
        self.vehicle.send(ack, sender.port)
        if self.reboot_wanted:
            self.reboot_wanted = False
            self.vehicle.reboot()

    # --- at every tick -----------------------------------------------------------------------------

    def control(self, dt_s: float) -> Drive:
        """Say what the chassis shall do until the next tick."""
        return self.steering.control(dt_s)

    def attend(self) -> None:
        """Do what is due: time-outs, lists, texts."""
        self.routine.attend()
        self.parameters.attend()

    def use_compasses(self, dt_s: float) -> None:
        """Correct the new readings and let the filter have the one that steers."""
        self.compasses.read()
        self.vehicle.filter.correct(dt_s, self.compass_yaw())
        self.magnetometer_calibration.observe(self.vehicle.body.yaw_rad)

    def compass_yaw(self) -> float | None:
        """Return the heading of the compass that steers; None where there is none to believe."""
        steering = self.compasses.steering
        if steering is None or not self.store["COMPASS_ENABLE"] or not self.compasses.in_use(steering):
            return None
        if not self.compasses.healthy(steering):
            return None
        estimate = self.vehicle.filter
        field = self.compasses.field(steering)
        return compass_yaw(field, estimate.roll_rad, estimate.pitch_rad, self.store["COMPASS_DEC"])

    # --- reports -----------------------------------------------------------------------------------

    def correction(self, instance: int) -> FieldCorrection:
        """Return the correction in force of compass 1, 2 or 3."""
        return self.compasses.correction(instance)

    def heartbeat(self) -> m.Heartbeat:
        """Describe the vehicle."""
        profile = self.vehicle.profile
        active = self.armed and not self.vehicle.body.landed if profile.hovers else True
        state = MavState.ACTIVE if active else MavState.STANDBY
        return m.Heartbeat(
            type=profile.mav_type,
            autopilot=MavAutopilot.ARDUPILOTMEGA,
            base_mode=self.modes.base_mode(self.mode, self.armed, profile.firmware),
            custom_mode=self.modes.names[self.mode],
            system_status=MavState.CRITICAL if self.failsafe else state,
        )

    def report(self, kind: type[m.Message], time_us: int, share: float) -> m.Message | None:
        """Build a telemetry message."""
        return self.reports.build(kind, time_us, share)

    def default_intervals(self) -> Mapping[int, int]:
        """Return what the SR0 parameters stream."""
        return {
            number: int(1e6 / rate)
            for number, (_, group) in MESSAGES.items()
            if group and (rate := self.store.get(f"SR0_{group}")) > 0.0
        }

    # --- what happens to it ------------------------------------------------------------------------

    def pilot_disarms(self) -> None:
        """Disarm by the pilot's hand."""
        self.disarm()

    def pilot_switches_mode(self, mode: str) -> None:
        """Change mode by the pilot's hand."""
        self.set_mode(mode)

    def pilot_moves_stick(self, channel: int, pwm: int, for_s: float) -> None:
        """Hold a stick."""
        self.radio.hold(channel, pwm, self.vehicle.boot_time_s + for_s)

    def battery_failsafe(self) -> None:
        """Warn, and stop or come down."""
        self.battery_low = self.failsafe = True
        volts, used = self.reports.battery_volts(), self.vehicle.consumed_mah
        self.vehicle.say(f"Battery 1 is low {volts:.2f}V used {used:.0f} mAh", MavSeverity.WARNING)
        self.vehicle.say("Battery Failsafe", MavSeverity.CRITICAL)
        self.set_mode({"rover": "HOLD", "copter": "LAND", "sub": "SURFACE"}[self.vehicle.profile.firmware])

    def lose_compass(self, instance: int, healthy: bool, value: Vector | None) -> None:
        """Stop a compass, at a raw value or at its last reading."""
        self.compasses.lose(instance, healthy, value)
