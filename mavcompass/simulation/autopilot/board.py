"""The flight controller's hardware (clock, body, sensors, ports), and what its firmware remembers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavcompass.enums import COMPONENT_AUTOPILOT, MavSeverity
from mavcompass.messages import Message, Statustext
from mavcompass.simulation.autopilot.attitude_filter import AttitudeFilter
from mavcompass.simulation.physics.motion import Body
from mavcompass.simulation.physics.sensors import CompassSetup, Distortion, SensorSuite, Surroundings

# Texts that nobody was there to read are dropped after this.
_STALE_US = 5_000_000
_REBOOT_SILENCE_US = 1_500_000


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Wrap a message that leaves the flight controller.

    Attributes:
        time_s: virtual time at which it left.
        system, component: the sender; not always the vehicle, for it forwards other stations.
        port: the port it leaves by, None for all of them.
    """

    time_s: float
    system: int
    component: int
    message: Message
    port: int | None = None


@dataclass(slots=True)
class Status:
    """Hold the vehicle's state as its firmware sees it.

    Attributes:
        failsafe: the heartbeat says CRITICAL. reboot_wanted: reboot once the command is acknowledged.
    """

    mode: str
    armed: bool = False
    battery_low: bool = False
    failsafe: bool = False
    reboot_wanted: bool = False


class Board:
    """Be what a firmware runs on.

    Attributes:
        compass_setups: the compasses, with the calibrations in force at the start.
        now_us: time since the simulation began; boot_us: when it was powered up last; boots: reboots since.
        silent_until_us: the end of a reboot's silence, None outside one.
        sent: what has left by the ports. uid: the board's serial number.
    """

    def __init__(
        self,
        body: Body,
        compasses: Sequence[CompassSetup],
        distortions: Sequence[Distortion],
        *,
        seed: int,
        system: int,
        ready_s: float,
        boot_us: int,
    ) -> None:
        self.seed = seed
        self.system, self.component = system, COMPONENT_AUTOPILOT
        self.profile, self.world, self.body = body.profile, body.world, body
        self.tick_us = self.profile.tick_us
        self.compass_setups = tuple(compasses)
        self.sensors = SensorSuite(
            [setup.model for setup in self.compass_setups],
            distortions,
            seed,
            self.tick_us * 1e-6,
            self.profile.vibration_mps2,
        )
        self.filter = AttitudeFilter(seed)
        self.ready_s = ready_s
        self.now_us, self.boot_us, self.boots = 0, boot_us, 0
        self.silent_until_us: int | None = None
        self.consumed_mah = 0.0
        self.uid = 1
        self.sent: list[Outgoing] = []
        self._untold: list[tuple[int, Statustext]] = []
        self._read_until_us = math.inf

    @property
    def boot_time_s(self) -> float:
        """Return the time since power-up or the last reboot."""
        return (self.now_us - self.boot_us) * 1e-6

    @property
    def ready(self) -> bool:
        """Tell whether the position is known."""
        return self.boot_time_s >= self.ready_s

    def reboot(self) -> None:
        """Fall silent, to power up again."""
        self.silent_until_us = self.now_us + _REBOOT_SILENCE_US

    def power_up(self) -> None:
        """End a reboot's silence: the clock starts anew, the filter knows nothing."""
        self.silent_until_us = None
        self.boot_us = self.now_us
        self.boots += 1
        self.filter.restart(self.boots)

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

    def send(self, message: Message, port: int | None = None, time_us: int | None = None) -> None:
        """Send a message, now or as of a time just past, by one port or by all."""
        time_us = self.now_us if time_us is None else time_us
        self.sent.append(Outgoing(time_us * 1e-6, self.system, self.component, message, port))

    def forward(self, message: Message, system: int, component: int, port: int | None = None) -> None:
        """Send another station's message on."""
        self.sent.append(Outgoing(self.now_us * 1e-6, system, component, message, port))

    def say(self, text: str, severity: MavSeverity = MavSeverity.INFO) -> None:
        """Send a STATUSTEXT by all ports, or as soon as somebody is there to read it."""
        self._untold.append((self.now_us, Statustext(severity, text[:50])))
        self._tell()

    def read_for(self, seconds: float) -> None:
        """Tell texts for so long from now on, and those that have just been said."""
        self._read_until_us = self.now_us + round(1e6 * seconds)
        self._tell()

    def _tell(self) -> None:
        if self.now_us <= self._read_until_us:
            for said_us, text in self._untold:
                if self.now_us - said_us < _STALE_US:
                    self.send(text)
            self._untold.clear()
