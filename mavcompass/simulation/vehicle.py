"""A simulated vehicle: a flight controller's board with its firmware, in a world; no sockets.

    vehicle = SimulatedAutopilot("rover", seed=7)
    vehicle.receive(ParamRequestRead(param_id="COMPASS_OFS_X"), system=255, component=190)
    for out in vehicle.advance(vehicle.time_s + 1.0):
        ...

Time moves only in `advance`, by fixed ticks; all randomness comes from the seed. The same seed and the
same messages at the same times give the same bytes, however the calls to `advance` are cut.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Mapping, MutableMapping, Sequence

from mavcompass.enums import MavAutopilot, MavState, MavType
from mavcompass.messages import Heartbeat, Message
from mavcompass.simulation.ardupilot import ArduPilot
from mavcompass.simulation.autopilot.board import Board, Outgoing
from mavcompass.simulation.autopilot.firmware import Firmware, Sender
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.physics.motion import Body, Drive
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.physics.profiles import profile
from mavcompass.simulation.physics.sensors import (
    COMPASS_PERIOD_US,
    Calibration,
    CompassSetup,
    Distortion,
    Truth,
    draw_compasses,
    truth_of,
)
from mavcompass.simulation.physics.world import DEFAULT_UTC_S, draw_world
from mavcompass.simulation.px4 import Px4

GROUND_STATION = (255, 190)
_HEARTBEAT_US = 1_000_000
_UPTIME_AT_START_US = 60_000_000


class SimulatedAutopilot:
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
        vehicle: rover, ackermann-rover, boat, copter, sub, quadplane, px4-copter or px4-vtol.
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
        kind = profile(vehicle)
        rng = generator(seed, "start")
        yaw_deg = rng.uniform(-180.0, 180.0) if start_yaw_deg is None else start_yaw_deg
        world = draw_world(kind, seed, place, utc_start_s, tilt_deg)
        if compasses is None:
            calibration = calibration or ("exact" if effects else "old")
            compasses = draw_compasses(seed, world.horizontal_mgauss, calibration)
        self.board = Board(
            Body(kind, world, seed, math.radians(yaw_deg)),
            compasses,
            _distortions(effects),
            seed=seed,
            system=system,
            ready_s=ready_s,
            boot_us=-_UPTIME_AT_START_US if armed else 0,
        )
        self.profile, self.world, self.body = kind, world, self.board.body
        self.moor("")
        self.filter = self.board.filter
        self._other_stations = tuple(other_stations)
        self._deaf_to = frozenset(deaf_to)
        self._until_us = 0
        self._drive = Drive()
        make = Px4 if kind.firmware == "px4" else ArduPilot
        self.firmware: Firmware = make(self.board, dict(parameters or {}), storage)
        self._start(armed)

    # --- the face towards the link -----------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Return the virtual time, seconds since the simulation began."""
        return self._until_us * 1e-6

    @property
    def truth(self) -> Truth:
        """Return how things really are now: for judging results, never for getting them."""
        return truth_of(self.body, self.board.surroundings(), self.board.now_us * 1e-6)

    @property
    def boots(self) -> int:
        """Return how often it has rebooted."""
        return self.board.boots

    @property
    def rebooting(self) -> bool:
        """Tell whether the vehicle is silent because it reboots."""
        return self.board.silent_until_us is not None

    def reboot(self) -> None:
        """Fall silent and power up again; what was written to parameters stays."""
        self.board.reboot()

    def moor(self, berth: str) -> None:
        """Take a place: of two alike at different places each has a serial number of its own."""
        maker = f"{self.profile.name},{self.board.seed},{self.board.system},{berth}"
        self.board.uid = int.from_bytes(hashlib.sha256(maker.encode()).digest()[:8], "little")

    def receive(self, message: Message, system: int, component: int, port: int = 0) -> None:
        """Take a message from a station; the answer leaves with the next `advance`."""
        telemetry = self.firmware.telemetry
        telemetry.streams(port)
        if self.rebooting or type(message) in self._deaf_to:
            return
        if isinstance(message, Heartbeat):
            for other in telemetry.ports:
                if other != port:
                    self.board.forward(message, system, component, other)
        self.firmware.handle(message, Sender(system, component, port))

    def advance(self, until_s: float) -> list[Outgoing]:
        """Let time pass up to `until_s` (virtual seconds); return what was sent meanwhile."""
        self._until_us = max(self._until_us, round(until_s * 1e6))
        while self.board.now_us + self.board.tick_us <= self._until_us:
            self._tick()
        sent, self.board.sent = self.board.sent, []
        sent.sort(key=_leaving_time)
        return sent

    # --- what happens to it from outside -----------------------------------------------------------

    def disarm(self) -> None:
        """Let the pilot disarm."""
        self.firmware.arming.disarm()

    def pilot_switches_mode(self, mode: str) -> None:
        """Let the pilot move the mode switch."""
        self.firmware.modes.enter(mode)

    def pilot_moves_stick(self, channel: int = 1, pwm: int = 1800, for_s: float = 3.0) -> None:
        """Let the pilot hold a stick (RC channel) away from its centre for a while."""
        self.firmware.pilot_moves_stick(channel, pwm, for_s)

    def turn_by_hand(self, moves: Iterable[HandMove]) -> None:
        """Let a person turn the vehicle, from now on or after the moves already planned."""
        self.body.hand.add(moves, self.body.time_s)

    def jam(self) -> None:
        """Block what turns the vehicle: wheels in the mud, a rope in the propeller."""
        self.body.jammed = True

    def battery_failsafe(self) -> None:
        """Let the battery run low."""
        self.firmware.battery_failsafe()

    def cut_sensor(self, instance: int = 1) -> None:
        """Unplug a compass: its last value keeps streaming, its health falls."""
        self.firmware.compasses.lose(instance, healthy=False, value=None)

    def zero_compass(self, instance: int = 1) -> None:
        """Let a compass deliver zeros: what is left are its offsets."""
        self.firmware.compasses.lose(instance, healthy=True, value=(0.0, 0.0, 0.0))

    # --- the works ---------------------------------------------------------------------------------

    def _start(self, armed: bool) -> None:
        if armed and self.profile.hovers:
            self.body.place_at_height(self.profile.hover_m)
        self._sense()
        self.board.sensors.read_compasses()
        self.firmware.boot(armed)

    def _sense(self) -> None:
        self.board.sensors.tick(self.body, self.board.surroundings)

    def _tick(self) -> None:
        board, body = self.board, self.body
        dt = board.tick_us * 1e-6
        drive = self._drive if board.silent_until_us is None else Drive()
        body.step(dt, drive, board.sensors.samples[0].gyro_radps[2])
        board.now_us += board.tick_us
        self._sense()
        if board.silent_until_us is not None:
            if board.now_us >= board.silent_until_us:
                self._power_up()
            return
        attitude = body.roll_rad, body.pitch_rad, body.yaw_rad
        sample, (x, y, _) = board.sensors.samples[0], body.specific_force_mps2
        off = sample.acc_mps2[0] - x, sample.acc_mps2[1] - y
        board.filter.predict(dt, sample.gyro_radps, attitude, body.acceleration_mps2, off)
        if board.now_us % COMPASS_PERIOD_US == 0:
            board.sensors.read_compasses()
            self.firmware.use_compasses(COMPASS_PERIOD_US * 1e-6)
        self._drive = self.firmware.steering.control(dt)
        self.firmware.attend()
        if board.now_us % _HEARTBEAT_US == 0:
            board.consumed_mah += board.surroundings().current_a * _HEARTBEAT_US * 1e-6 / 3.6
            self._heartbeats()
        self.firmware.telemetry.attend()

    def _power_up(self) -> None:
        self._drive = Drive()
        self.board.power_up()
        self.firmware.telemetry.reset()
        self.board.sensors.read_compasses()
        self.firmware.boot(armed=False)

    def _heartbeats(self) -> None:
        # The forwarded ones leave first: the first heartbeat a client hears need not be the vehicle's.
        for system, component in self._other_stations:
            self.board.forward(
                Heartbeat(MavType.GCS, MavAutopilot.INVALID, 0, 0, MavState.ACTIVE), system, component
            )
        self.board.send(self.firmware.reports.heartbeat())


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
