"""The simulated flight controller: its clock, its body, its sensors, its ports; no sockets.

    vehicle = SimulatedAutopilot("rover", seed=7)
    vehicle.receive(ParamRequestRead(param_id="COMPASS_OFS_X"), system=255, component=190)
    for out in vehicle.advance(vehicle.time_s + 1.0):
        ...

Time moves only in `advance`, by fixed ticks; all randomness comes from the seed. The same seed and the
same messages at the same times give the same bytes, however the calls to `advance` are cut.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, MutableMapping, Sequence

from mavcompass.enums import COMPONENT_AUTOPILOT, MavAutopilot, MavSeverity, MavState, MavType
from mavcompass.messages import Heartbeat, Message, Statustext
from mavcompass.simulation.ardupilot.firmware import ArduPilot
from mavcompass.simulation.autopilot.attitude_filter import AttitudeFilter
from mavcompass.simulation.autopilot.firmware import Firmware, Sender
from mavcompass.simulation.autopilot.outgoing import Outgoing
from mavcompass.simulation.autopilot.streams import MESSAGES, Streams
from mavcompass.simulation.happenings import Happenings
from mavcompass.simulation.physics.compasses import Calibration, CompassSetup, draw_compasses
from mavcompass.simulation.physics.motion import Body, Drive
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.profiles import VehicleProfile, profile
from mavcompass.simulation.physics.scenery import draw_world
from mavcompass.simulation.physics.sensors import COMPASS_PERIOD_US, Distortion, SensorSuite, Surroundings
from mavcompass.simulation.physics.world import DEFAULT_UTC_S
from mavcompass.simulation.px4.firmware import Px4
from mavcompass.simulation.truth import Truth, truth_of

GROUND_STATION = (255, 190)
_HEARTBEAT_US = 1_000_000
_REBOOT_SILENCE_US = 1_500_000
_UPTIME_AT_START_US = 60_000_000


class SimulatedAutopilot(Happenings):
    """Behave as a vehicle's flight controller does, towards messages of `mavcompass.messages`."""

    def __init__(
        self,
        vehicle: str,
        *,
        seed: int = 0,
        effects: Sequence[Distortion | str] = (),
        parameters: Mapping[str, float] | None = None,
        storage: MutableMapping[str, float] | None = None,
        place: tuple[float, float, float] | None = None,
        utc_start_s: float = DEFAULT_UTC_S,
        armed: bool = True,
        ready_s: float = 6.0,
        start_yaw_deg: float | None = None,
        compasses: Sequence[CompassSetup] | None = None,
        calibration: Calibration | None = None,
        tilt_deg: float | None = None,
        system: int = 1,
        other_stations: Sequence[tuple[int, int]] = (GROUND_STATION,),
        deaf_to: Collection[type[Message]] = (),
    ) -> None:
        """Build a vehicle.

        Parameters
        ----------
        vehicle: rover, ackermann-rover, boat, copter, sub or px4-copter.
        seed: of everything random: iron, start heading, noise.
        effects: further physical effects on the first compass and IMU, ready or as text
            ("hard_iron:x=100,y=-50").
        parameters: values other than the defaults; they give way to what `storage` holds.
        storage: what has been written to the vehicle; hand it to another instance to keep it.
        place: latitude deg, longitude deg, altitude m; the firmware's usual place by default.
        armed: start armed in GUIDED, position known, hovering where it flies; otherwise it starts at
            power-up, disarmed.
        ready_s: from power-up until the position is known (real firmware: 36 s and more).
        start_yaw_deg: true heading at the start; by seed if not given.
        compasses: three compasses and their calibrations; by seed if not given.
        calibration: "old" (wrong; the default) or "exact" (the default where effects are given).
        tilt_deg: steepness of the ground, height of the waves as tilt; by seed if not given.
        other_stations: (system, component) of those whose heartbeats this vehicle forwards.
        deaf_to: messages that this firmware does not know, for trying what a client does then.
        """
        self.profile: VehicleProfile = profile(vehicle)
        self.seed = seed
        self.system, self.component = system, COMPONENT_AUTOPILOT
        self.ready_s = ready_s
        self.other_stations = tuple(other_stations)
        self._deaf_to = frozenset(deaf_to)
        rng = generator(seed, "start")
        yaw_deg = rng.uniform(-180.0, 180.0) if start_yaw_deg is None else start_yaw_deg
        self.world = draw_world(self.profile, seed, place, utc_start_s, tilt_deg)
        if compasses is None:
            kind = calibration or ("exact" if effects else "old")
            compasses = draw_compasses(seed, self.world.horizontal_mgauss, kind)
        self.compass_setups = tuple(compasses)
        self.body = Body(self.profile, self.world, seed, math.radians(yaw_deg))
        self.tick_us = self.profile.tick_us
        self.sensors = SensorSuite(
            [c.model for c in self.compass_setups],
            _distortions(effects),
            seed,
            self.tick_us * 1e-6,
            self.profile.vibration_mps2,
        )
        self.now_us = 0
        self.boot_us = -_UPTIME_AT_START_US if armed else 0
        self.boots = 0
        self.silent_until_us: int | None = None
        self.drive = Drive()
        self.consumed_mah = 0.0
        self._until_us = 0
        self._outbox: list[Outgoing] = []
        self._ports: dict[int, Streams] = {}
        make = Px4 if self.profile.firmware == "px4" else ArduPilot
        self.firmware: Firmware = make(self, dict(parameters or {}), storage)
        self.filter = AttitudeFilter(seed, self.boots)
        self._start(armed)

    # --- the face towards the link -----------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Return the virtual time, seconds since the simulation began."""
        return self._until_us * 1e-6

    @property
    def truth(self) -> Truth:
        """Return how things really are now: for judging results, never for getting them."""
        return truth_of(self)

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Take a message from a station; the answer leaves with the next `advance`."""
        self._port(port)
        if self.rebooting or type(message) in self._deaf_to:
            return
        if isinstance(message, Heartbeat):
            for other in self._ports:
                if other != port:
                    self._emit(self.now_us, system, component, message, other)
        self.firmware.handle(message, Sender(system, component, port))

    def advance(self, until_s: float) -> list[Outgoing]:
        """Let time pass up to `until_s` (virtual seconds); return what was sent meanwhile."""
        self._until_us = max(self._until_us, round(until_s * 1e6))
        while self.now_us + self.tick_us <= self._until_us:
            self._tick()
        sent, self._outbox = self._outbox, []
        sent.sort(key=_leaving_time)
        return sent

    # --- what the firmware uses --------------------------------------------------------------------

    def send(self, message: Message, port: int | None = None) -> None:
        """Send a message now, by one port or by all."""
        self._emit(self.now_us, self.system, self.component, message, port)

    def say(self, text: str, severity: MavSeverity = MavSeverity.INFO) -> None:
        """Send a STATUSTEXT by all ports."""
        self.send(Statustext(severity, text[:50]))

    @property
    def boot_time_s(self) -> float:
        """Return the time since power-up or the last reboot."""
        return (self.now_us - self.boot_us) * 1e-6

    @property
    def ready(self) -> bool:
        """Tell whether the position is known."""
        return self.boot_time_s >= self.ready_s

    @property
    def rebooting(self) -> bool:
        """Tell whether the vehicle is silent because it reboots."""
        return self.silent_until_us is not None

    def streams(self, port: int) -> Streams:
        """Return the message rates of a port."""
        return self._port(port)

    def reboot(self) -> None:
        """Fall silent and power up again; what was written to parameters stays."""
        self.silent_until_us = self.now_us + _REBOOT_SILENCE_US
        self.drive = Drive()

    # --- the works ---------------------------------------------------------------------------------

    def _start(self, armed: bool) -> None:
        if armed and self.profile.hovers:
            self.body.place_at_height(self.profile.hover_m)
        self._port(0)
        self._sense()
        self.sensors.read_compasses()
        self.firmware.boot(armed)

    def _sense(self) -> None:
        self.sensors.tick(self.body, self.surroundings)

    def surroundings(self) -> Surroundings:
        """Return current, throttle and temperature at this moment."""
        p, body = self.profile, self.body
        rest, moving, turning = p.currents_a
        current, throttle = rest, 0.0
        if body.motors_on:
            moves = 1.0 if p.hovers and not body.landed else abs(body.speed_mps) / p.speed_max_mps
            effort = abs(body.yaw_rate_radps)
            current += moves * (moving - rest) + turning * effort
            throttle = min(1.0, 0.39 * moves + 0.1 * effort)
        warm = 1.0 - math.exp(-self.boot_time_s / 600.0)
        return Surroundings(current, throttle, 25.0 + 15.0 * warm, (throttle,) * 4)

    def _tick(self) -> None:
        dt = self.tick_us * 1e-6
        gyro = self.sensors.samples[0].gyro_radps
        self.body.step(dt, self.drive, gyro[2])
        self.now_us += self.tick_us
        self._sense()
        if self.silent_until_us is not None:
            if self.now_us >= self.silent_until_us:
                self._power_up()
            return
        body = self.body
        gyro = self.sensors.samples[0].gyro_radps
        self.filter.predict(dt, gyro, body.roll_rad, body.pitch_rad)
        if self.now_us % COMPASS_PERIOD_US == 0:
            self.sensors.read_compasses()
            self.firmware.use_compasses(COMPASS_PERIOD_US * 1e-6)
        self.drive = self.firmware.control(dt)
        self.firmware.attend()
        if self.now_us % _HEARTBEAT_US == 0:
            self.consumed_mah += self.surroundings().current_a * _HEARTBEAT_US * 1e-6 / 3.6
            self._heartbeats()
        for port, streams in self._ports.items():
            for time_us, number in streams.due(self.now_us):
                self._stream(time_us, number, port)

    def _power_up(self) -> None:
        self.silent_until_us = None
        self.boot_us = self.now_us
        self.boots += 1
        self.filter = AttitudeFilter(self.seed, self.boots)
        for port in self._ports:
            self._ports[port] = self._new_streams()
        self.sensors.read_compasses()
        self.firmware.boot(armed=False)

    def _heartbeats(self) -> None:
        # The forwarded ones leave first: the first heartbeat a client hears need not be the vehicle's.
        for system, component in self.other_stations:
            station = Heartbeat(MavType.GCS, MavAutopilot.INVALID, 0, 0, MavState.ACTIVE)
            self._emit(self.now_us, system, component, station, None)
        self._emit(self.now_us, self.system, self.component, self.firmware.heartbeat(), None)

    def _stream(self, time_us: int, number: int, port: int) -> None:
        # Messages between two ticks carry readings interpolated between them.
        share = 1.0 - (self.now_us - time_us) / self.tick_us
        message = self.firmware.report(MESSAGES[number][0], time_us, share)
        if message is not None:
            self._emit(time_us, self.system, self.component, message, port)

    def _emit(self, time_us: int, system: int, component: int, message: Message, port: int | None) -> None:
        self._outbox.append(Outgoing(time_us * 1e-6, system, component, message, port))

    def _port(self, port: int) -> Streams:
        if port not in self._ports:
            self._ports[port] = self._new_streams()
        return self._ports[port]

    def _new_streams(self) -> Streams:
        firmware, profile = self.firmware, self.profile
        return Streams(
            profile.loop_us,
            int(profile.loop_us / profile.rate_share),
            firmware.available,
            firmware.default_intervals(),
            self.now_us,
        )


def _leaving_time(out: Outgoing) -> float:
    return out.time_s


def _distortions(effects: Sequence[Distortion | str]) -> list[Distortion]:
    """Make those effects that are given as text, all of them in one chain, in the order of causes."""
    ready = [e for e in effects if not isinstance(e, str)]
    texts = [e for e in effects if isinstance(e, str)]
    if texts:
        from mavcompass.simulation.effects.registry import distortion

        ready.append(distortion(texts))
    return ready
